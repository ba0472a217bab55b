"""The studio's door: every request passes it before a route is looked for, and without the owner's token none gets in.

The owner's browser is opened at an address with a token, which is exchanged for a cookie; programs send the token in
each request. Whoever has neither learns nothing, a page of another site that the browser shows gets nothing done.
"""

from __future__ import annotations

import hmac
import os
import re
import secrets
import socket
import sys
import threading
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote, urlencode

from werkzeug.wrappers import Request, Response

from dynamics.errors import RequestError

if TYPE_CHECKING:
    from _typeshed.wsgi import StartResponse, WSGIApplication, WSGIEnvironment

VARIABLE = "ALULA_STUDIO_TOKEN"
PARAMETER = "token"
HOST = "127.0.0.1"
MIN_LENGTH = 8  # characters of a token that the user chooses
HEADERS = {
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
}
_CONNECTIONS = (Path("/proc/net/tcp"), Path("/proc/net/tcp6"))  # of Linux: who holds the ends of each connection
_ESTABLISHED = "01"


class Owner:
    """The user whose studio it is, known by a token. token: the user's own choice, empty for a random one.

    Raises RequestError for a token that is guessed too easily, or that no address can carry.
    """

    def __init__(self, token: str = "") -> None:
        if token and not re.fullmatch(rf"[!-~]{{{MIN_LENGTH},}}", token):
            raise RequestError(
                f"the token has {len(token)} characters; wanted are {MIN_LENGTH} or more, of ASCII without spaces. "
                f"Leave it out for a random one, or give {VARIABLE} what `openssl rand -hex 16` prints."
            )
        self._token = token or secrets.token_urlsafe(24)
        self._session = secrets.token_urlsafe(32)
        self._code = secrets.token_urlsafe(24)
        self._unused = threading.Lock()  # held once the code was used where nobody can see by whom

    def address(self, page: str) -> str:
        """A page's address with the token, for the owner to read."""
        return f"{page}?{PARAMETER}={quote(self._token, safe='')}"

    def browser_address(self, page: str) -> str:
        """A page's address for the command line of a browser, which other users can read in the list of processes.

        It holds no token but a code, which is good from this user's connections alone; where the system does not say
        whose a connection is, it is good once.
        """
        return f"{page}?{PARAMETER}={self._code}"

    def cookie(self, port: int) -> tuple[str, str]:
        """Name and value of the cookie. Cookies do not tell ports apart: each studio has a name of its own."""
        return f"alula_studio_{port}", self._session

    def is_in_address(self, request: Request) -> bool:
        """Whether the request's address holds the token, or the code of this user's browser."""
        values = request.args.getlist(PARAMETER)
        # all of them, so that the time of an answer does not depend on which one is right
        by_token = [_is_same(value, self._token) for value in values]
        by_code = [_is_same(value, self._code) for value in values]
        return any(by_token) or (any(by_code) and self._takes_code(request))

    def is_known(self, request: Request, port: int) -> bool:
        """Whether the request has the cookie, or the token in its header `Authorization: Bearer TOKEN`."""
        name, value = self.cookie(port)
        scheme, _, token = request.headers.get("Authorization", "").partition(" ")
        by_cookie = [_is_same(text, value) for text in request.cookies.getlist(name)]
        by_header = _is_same(token.strip(), self._token)
        return any(by_cookie) or (by_header and scheme.lower() == "bearer")

    def _takes_code(self, request: Request) -> bool:
        user = _user_at_other_end(request.environ)
        if user is None:
            return self._unused.acquire(blocking=False)
        return user in (os.getuid(), 0)  # 0: who reads every process' memory anyway


class Door:
    """A WSGI application in front of another one, which sees the owner's requests alone."""

    def __init__(self, inside: WSGIApplication, owner: Owner, port: int) -> None:
        self._inside = inside
        self._owner = owner
        self._port = port
        self._names = frozenset(f"{name}:{port}" for name in (HOST, "localhost", "[::1]"))

    def __call__(self, environ: WSGIEnvironment, start_response: StartResponse) -> Iterable[bytes]:
        """Answer a request, or pass it on."""
        request = Request(environ, populate_request=False)
        brings_token = self._owner.is_in_address(request)
        if not brings_token and not self._owner.is_known(request, self._port):
            return _sent(self._refusal(401, ""), environ, start_response)
        if reason := self._foreign(request):
            return _sent(self._refusal(403, reason), environ, start_response)
        if not brings_token:
            return self._inside(environ, start_response)
        if request.method in ("GET", "HEAD") and "text/html" in request.headers.get("Accept", ""):
            return _sent(self._with_cookie(self._redirect(request)), environ, start_response)

        def start(status: str, headers: list[tuple[str, str]], *error: Any) -> Any:
            return start_response(status, [*headers, *cookie], *error)

        cookie = [pair for pair in self._with_cookie(Response()).headers if pair[0] == "Set-Cookie"]
        return self._inside(environ, start)

    def _foreign(self, request: Request) -> str:
        """Why a request was sent by no page of this studio and no program of this computer, empty for the others.

        A foreign Host header is what DNS rebinding brings.
        """
        if request.environ.get("HTTP_HOST", "") not in self._names:
            return f"This studio answers to http://{HOST}:{self._port}/ alone."
        origin = request.headers.get("Origin")
        is_ours = origin is None or origin in {f"http://{name}" for name in self._names}
        if is_ours and request.headers.get("Sec-Fetch-Site", "same-origin") in ("same-origin", "none"):
            return ""
        return "A page of another site may not use this studio."

    @staticmethod
    def _refusal(status: int, text: str) -> Response:
        response = Response(text, status=status, headers=HEADERS, mimetype="text/plain")
        response.headers["Cache-Control"] = "no-store"
        if status == 401:
            del response.headers["Content-Type"]
            response.headers["WWW-Authenticate"] = "Bearer"
        return response

    def _redirect(self, request: Request) -> Response:
        """Redirect to the page without the token, which then is in no address bar, no bookmark and no history."""
        rest = [(name, value) for name, value in request.args.items(multi=True) if name != PARAMETER]
        place = quote(request.path, safe="/") + (f"?{urlencode(rest)}" if rest else "")
        response = self._refusal(303, "")
        response.headers["Location"] = f"http://{request.environ['HTTP_HOST']}{place}"
        return response

    def _with_cookie(self, response: Response) -> Response:
        name, value = self._owner.cookie(self._port)
        response.set_cookie(name, value, httponly=True, samesite="Strict", path="/")
        return response


def _sent(response: Response, environ: WSGIEnvironment, start_response: StartResponse) -> Iterable[bytes]:
    parts: Iterable[bytes] = response(environ, start_response)
    return parts


def _is_same(text: str, secret: str) -> bool:
    """Whether a text is the secret, in a time that does not say where they differ."""
    return hmac.compare_digest(text.encode("utf-8", "replace"), secret.encode())


def _user_at_other_end(environ: WSGIEnvironment) -> int | None:
    """The user id of the process that sent a request from this computer; -1 for none, None where no system says it."""
    if not _CONNECTIONS[0].exists():
        return None
    try:
        here = f":{int(environ['SERVER_PORT']):04X}"
        there = f"{_hexadecimal(environ['REMOTE_ADDR'])}:{int(environ['REMOTE_PORT']):04X}"
        lines = [line for path in _CONNECTIONS if path.exists() for line in path.read_text().splitlines()[1:]]
    except (KeyError, ValueError, OSError):
        return -1
    for line in lines:
        _, local, remote, state, _, _, _, user, *_ = line.split()
        # an IPv6 socket that connects to an IPv4 address has this one at the end of its own
        if local.endswith(there) and remote.endswith(here) and state == _ESTABLISHED:
            return int(user)
    return -1


def _hexadecimal(address: str) -> str:
    """An IPv4 address as Linux lists it."""
    return f"{int.from_bytes(socket.inet_aton(address), sys.byteorder):08X}"
