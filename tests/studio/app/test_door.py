"""The studio's door: nobody gets in without the owner's token, on any route, and the token stays where it belongs."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import threading
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from flask.testing import FlaskClient
from werkzeug.routing import Rule

from alula.cli.output import split_output
from dynamics.errors import RequestError
from studies.results.read import RESULTS
from studio.app import door
from studio.app.door import VARIABLE, Owner
from studio.app.server import PORT, make_app, serve
from studio.app.studio import Studio

TOKEN = "a-token-of-these-tests"
BASE = f"http://127.0.0.1:{PORT}"
METHODS = ("GET", "HEAD", "OPTIONS", "POST", "PUT", "DELETE", "PATCH", "TRACE", "CONNECT", "PROPFIND")
HTML = {"Accept": "text/html,application/xhtml+xml"}


@pytest.fixture(scope="module")
def studio(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Studio]:
    room = Studio(tmp_path_factory.mktemp("cases"), RESULTS)
    yield room
    room.close()


@pytest.fixture(scope="module")
def case(studio: Studio) -> str:
    name = studio.create(name="private")
    opened = studio.case(name)
    assert opened is not None
    opened.case.set_vehicle("px4_sih")
    return name


@pytest.fixture(scope="module")
def app(studio: Studio) -> Any:
    return make_app(studio, PORT, Owner(TOKEN)).server


@pytest.fixture
def client(app: Any) -> FlaskClient:
    client: FlaskClient = app.test_client()
    return client


def _paths(rule: Rule, case: str) -> str:
    """A path of a route, of a case that there is where it takes one."""
    values: dict[str, Any] = {
        "name": case, "number": 1, "filename": "studio.js", "path": f"case/{case}/log", "package_name": "dash",
        "fingerprinted_path": "deps/react.js",
    }  # fmt: skip
    path: str = rule.rule
    for argument in rule.arguments:
        for pattern in (f"<{argument}>", f"<path:{argument}>", f"<int:{argument}>", f"<string:{argument}>"):
            path = path.replace(pattern, str(values[argument]))
    assert "<" not in path
    return path


def test_without_the_token_every_route_answers_401_and_nothing_else(app: Any, client: FlaskClient, case: str) -> None:
    rules = list(app.url_map.iter_rules())
    assert len(rules) >= 18
    assert not any(rule.websocket for rule in rules)
    paths = [*(_paths(rule, case) for rule in rules), f"/case/{case}/archive", "/nowhere/at/all", "/assets/none.js"]
    answers = set()
    for path in paths:
        for method in METHODS:
            answer = client.open(path, method=method, base_url=BASE, headers=HTML)
            assert answer.status_code == 401, (method, path)
            assert answer.get_data() == b"", (method, path)
            answers.add(tuple(sorted(answer.headers.items())))
    assert len(answers) == 1  # the same of what is there and of what is not
    assert not any("set-cookie" in name.lower() for name, _ in next(iter(answers)))


def test_a_websocket_is_a_request_like_others(client: FlaskClient) -> None:
    upgrade = {"Connection": "Upgrade", "Upgrade": "websocket", "Sec-WebSocket-Version": "13",
               "Sec-WebSocket-Key": "AAAAAAAAAAAAAAAAAAAAAA=="}  # fmt: skip
    for path in ("/", "/_dash-ws-callback", "/ws"):
        assert client.get(path, base_url=BASE, headers=upgrade).status_code == 401


@pytest.mark.parametrize(
    "headers",
    [{"Authorization": f"Bearer {TOKEN}"}, {"Authorization": f"bearer {TOKEN}"}],
)
def test_a_program_sends_the_token_as_a_header(client: FlaskClient, case: str, headers: dict[str, str]) -> None:
    answer = client.get(f"/case/{case}/vehicle/1.toml", base_url=BASE, headers=headers)
    assert answer.status_code == 200
    assert "Set-Cookie" not in answer.headers
    answer.close()


def test_a_program_sends_the_token_in_the_address(client: FlaskClient, case: str) -> None:
    answer = client.get(f"/case/{case}/vehicle/1.toml?token={TOKEN}", base_url=BASE)
    assert answer.status_code == 200
    answer.close()
    body = b"name = 3"
    answer = client.put(f"/case/{case}/vehicle?token={TOKEN}&name=v.toml", base_url=BASE, data=body)
    assert answer.status_code == 400


@pytest.mark.parametrize(
    "headers",
    [
        {"Authorization": TOKEN},
        {"Authorization": f"Basic {TOKEN}"},
        {"Authorization": f"Bearer {TOKEN[:-1]}"},
        {"Authorization": f"Bearer {TOKEN}x"},
        {"Authorization": "Bearer "},
        {"Authorization": "Bearer täken"},
        {"Cookie": f"alula_studio_{PORT}={TOKEN}"},
        {"Cookie": f"alula_studio_{PORT}="},
        {"Cookie": f"token={TOKEN}"},
        {"Referer": f"{BASE}/?token={TOKEN}"},
    ],
)
def test_anything_but_the_token_is_refused(client: FlaskClient, headers: dict[str, str]) -> None:
    assert client.get("/", base_url=BASE, headers=headers).status_code == 401


@pytest.mark.parametrize("query", ["token=", f"token={TOKEN[1:]}", f"Token={TOKEN}", "token=t%C3%A4ken", "token=%00"])
def test_another_token_in_the_address_is_refused(client: FlaskClient, query: str) -> None:
    assert client.get(f"/?{query}", base_url=BASE, headers=HTML).status_code == 401


def test_the_token_becomes_a_cookie_and_leaves_the_address(client: FlaskClient, case: str) -> None:
    answer = client.get(f"/case/{case}/log?token={TOKEN}&x=1%202", base_url=BASE, headers=HTML)
    assert answer.status_code == 303
    assert answer.headers["Location"] == f"{BASE}/case/{case}/log?x=1+2"
    assert TOKEN not in str(answer.headers)
    assert answer.headers["Referrer-Policy"] == "no-referrer"
    assert answer.headers["Cache-Control"] == "no-store"
    flags = answer.headers["Set-Cookie"].split("; ")
    assert {"HttpOnly", "SameSite=Strict", "Path=/"} <= set(flags)
    assert not any(flag.startswith("Domain") for flag in flags)
    page = client.get(f"/case/{case}/log", base_url=BASE, headers=HTML)
    assert page.status_code == 200
    assert page.headers["Referrer-Policy"] == "no-referrer"
    assert TOKEN not in page.get_data(as_text=True)
    other = {"Cookie": flags[0].replace(str(PORT), str(PORT + 1))}  # of a studio on another port
    assert client.application.test_client().get("/", base_url=BASE, headers=other).status_code == 401


@pytest.mark.parametrize("method", ["get", "post", "put"])
def test_the_owner_is_held_to_host_and_origin_too(client: FlaskClient, method: str) -> None:
    call = getattr(client, method)
    bearer = {"Authorization": f"Bearer {TOKEN}"}
    assert call("/", base_url="http://evil.example", headers=bearer).status_code == 403
    assert call("/", base_url=BASE, headers={**bearer, "Origin": "http://evil.example"}).status_code == 403
    assert call("/", base_url=BASE, headers={**bearer, "Sec-Fetch-Site": "cross-site"}).status_code == 403
    answer = call(f"/?token={TOKEN}", base_url="http://evil.example", headers=HTML)
    assert answer.status_code == 403
    assert "Set-Cookie" not in answer.headers
    assert call("//evil.example/", base_url=BASE).status_code == 401


@pytest.fixture
def served(studio: Studio) -> Iterator[tuple[Owner, str]]:
    """The owner of a server on a socket, and its address."""
    owner = Owner()
    server, address = serve(studio, owner, port=0)
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    yield owner, address
    server.shutdown()
    thread.join(10)
    server.server_close()


def _status(address: str) -> int:
    with urllib.request.build_opener(_Answers()).open(address, timeout=10) as answer:
        assert answer.status == 200 or not answer.read()
        return int(answer.status)


class _Answers(urllib.request.HTTPErrorProcessor):
    """Every status is an answer."""

    def http_response(self, request: Any, response: Any) -> Any:
        return response


def test_the_browsers_command_line_is_worth_nothing_to_another_user(
    served: tuple[Owner, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    owner, address = served
    by_browser = owner.browser_address(address)
    assert owner._token not in by_browser
    assert _status(by_browser) == 200
    assert _status(owner.address(address)) == 200
    assert _status(address) == 401
    monkeypatch.setattr(door.os, "getuid", lambda: 4_000_000_000)  # the studio of another user than this client's
    monkeypatch.setattr(door, "_user_at_other_end", lambda _, at=door._user_at_other_end: at(_) or 1)  # and no root
    assert _status(by_browser) == 401
    assert _status(owner.address(address)) == 200


def test_the_browsers_address_is_good_once_where_no_system_says_whose_a_connection_is(
    served: tuple[Owner, str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    owner, address = served
    monkeypatch.setattr(door, "_CONNECTIONS", (tmp_path / "tcp",))
    assert [_status(owner.browser_address(address)) for _ in range(3)] == [200, 401, 401]


def test_requests_that_are_none_learn_nothing(served: tuple[Owner, str], capfd: pytest.CaptureFixture[str]) -> None:
    owner, address = served
    port = int(address.rsplit(":", 1)[1].strip("/"))
    lines = [
        f"GET /?token={owner._token} HTTP/9.9 x",
        f"GET /?token={owner._token}\x01 y z",
        "\x16\x03\x01",
        "GET / HTTP/1.0",
    ]
    for line in lines:
        with socket.create_connection(("127.0.0.1", port), timeout=10) as stream:
            stream.sendall(f"{line}\r\n\r\n".encode())
            stream.shutdown(socket.SHUT_WR)
            answer = b"".join(iter(lambda stream=stream: stream.recv(4096), b""))  # type: ignore[misc]
        assert b"token" not in answer.lower()
        assert b"Python" not in answer
        assert b"Werkzeug" not in answer
    assert owner._token not in "".join(capfd.readouterr())


@pytest.mark.parametrize("token", ["short", "with a space in it", "with_ä_of_german"])
def test_a_token_that_is_guessed_or_cannot_be_sent_is_refused(token: str) -> None:
    with pytest.raises(RequestError, match="8 or more"):
        Owner(token)


def test_random_tokens_differ() -> None:
    tokens = {Owner()._token for _ in range(20)}
    assert len(tokens) == 20
    assert min(map(len, tokens)) >= 32


def test_the_command_keeps_the_token_out_of_log_files_and_of_the_browsers_command_line(tmp_path: Path) -> None:
    arguments = tmp_path / "arguments"
    browser = tmp_path / "browser"
    browser.write_text(
        f'#!/bin/sh\necho "$@" "$ALULA_STUDIO_TOKEN" > {arguments}.part; mv {arguments}.part {arguments}\n'
    )
    browser.chmod(0o700)
    command = [sys.executable, "-m", "alula", "--log-file", str(tmp_path / "log"), "studio", "--port", "0"]
    environment = {**os.environ, VARIABLE: TOKEN, "BROWSER": f"{browser} %s", "XDG_DATA_HOME": str(tmp_path)}
    environment.pop("ALULA_NO_BROWSER", None)
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment, cwd=tmp_path) as process:
        assert process.stdout is not None
        address = process.stdout.readline().split()[-1]
        assert address.endswith(f"/?token={TOKEN}")
        assert process.stdout.readline().startswith("Ctrl-C")
        assert _status(address) == 200
        for _ in range(200):
            if arguments.exists():
                break
            threading.Event().wait(0.05)
        called = arguments.read_text()
        assert called.startswith("http://127.0.0.1:")
        assert TOKEN not in called
        assert _status(called.strip()) == 200
        process.terminate()
        process.communicate(timeout=60)
    assert process.returncode == 0
    logged = (tmp_path / "log").read_text()
    assert "studio: http://127.0.0.1:" in logged
    assert TOKEN not in logged


@pytest.mark.parametrize("words", [["studio", "--token", TOKEN], ["studio", f"--token={TOKEN}"]])
def test_a_token_on_the_command_line_is_masked_in_the_log_file(words: list[str], tmp_path: Path) -> None:
    rest, output = split_output(["--log-file", str(tmp_path / "log"), *words])
    output.start(rest)
    output.finish(0)
    assert TOKEN not in (tmp_path / "log").read_text()
    assert rest == words
