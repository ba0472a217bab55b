"""The studio's server on the loopback interface: the page, uploads that are streamed to disk, downloads.

Only this computer reaches it, and of its users only the one whose studio it is (`studio.app.door`).
"""

from __future__ import annotations

import shutil
import socket
import tempfile
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import dash
import flask
import msgspec
from werkzeug.exceptions import ClientDisconnected
from werkzeug.serving import BaseWSGIServer, WSGIRequestHandler, make_server
from werkzeug.utils import secure_filename

from dynamics.decoding import decode_json
from dynamics.errors import AlulaError, RequestError
from dynamics.field_errors import described
from dynamics.files import write_whole
from dynamics.vehicle_file import with_effect_files
from studio.app.door import HEADERS, HOST, Door, Owner
from studio.app.opened import OpenCase
from studio.app.shell import build
from studio.app.studio import Studio
from studio.case.archive import ENDING, write_archive
from studio.case.commands import script

PORT = 8642
CHUNK = 1 << 20  # bytes of an upload in memory
MAX_TEXT = 4 << 20  # bytes of a vehicle or effect file
MAX_FIGURE = 64 << 20  # bytes of a picture that is saved
MAX_SIDE = 8000  # px of one


Side = Annotated[int, msgspec.Meta(ge=1, le=MAX_SIDE)]


class SavedFigure(msgspec.Struct):
    """A picture that a page sends to be drawn. data, layout: as plotly has them; width, height: px."""

    data: list[dict[str, Any]]
    layout: dict[str, Any]
    width: Side
    height: Side


class QuietHandler(WSGIRequestHandler):  # type: ignore[misc]
    """Requests are not printed: an address may hold the token. What is no HTTP is refused without a text."""

    error_message_format = ""

    def log(self, *_: Any, **__: Any) -> None:
        """Print nothing."""

    def version_string(self) -> str:
        """The header `Server`, which names no versions."""
        return "studio"


def make_app(studio: Studio, port: int, owner: Owner | None = None) -> dash.Dash:
    """The page of a studio and its routes.

    port: that it will be served on, which a Host header must name. owner: who may come in, by default one with a random
    token that nobody knows.
    """
    server = flask.Flask("studio")
    app = dash.Dash(
        "studio",
        server=server,
        title="Alula studio",
        update_title=None,
        serve_locally=True,
        suppress_callback_exceptions=True,
        assets_folder=str(Path(__file__).parent / "assets"),
    )
    _add_routes(server, studio)
    build(app, studio)
    policy = _content_policy(app)
    server.after_request(lambda response: _with_headers(response, policy))
    server.wsgi_app = Door(server.wsgi_app, owner or Owner(), port)
    return app


def serve(studio: Studio, owner: Owner | None = None, *, port: int | None = None) -> tuple[BaseWSGIServer, str]:
    """A server that is bound and waits for `serve_forever`, and the page's address, without the owner's token.

    port: None for the usual one, or the next that is free. Raises RequestError for a port that is taken.
    """
    bound = _bound_socket(port)
    number = bound.getsockname()[1]
    app = make_app(studio, number, owner)
    server = make_server(HOST, number, app.server, threaded=True, request_handler=QuietHandler, fd=bound.detach())
    return server, f"http://{HOST}:{number}/"


def _bound_socket(port: int | None) -> socket.socket:
    candidates = range(PORT, PORT + 20) if port is None else (port,)
    for number in candidates:
        bound = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            bound.bind((HOST, number))
            bound.listen(64)
        except OSError as error:
            bound.close()
            if port is not None:
                advice = "Another studio may be open there; give another --port, or 0 for a free one."
                raise RequestError(f"port {port} cannot be used: {error.strerror or error}. {advice}") from None
        else:
            return bound
    raise RequestError(f"ports {PORT} to {PORT + 19} are all taken. Give a --port, or 0 for a free one.")


def _content_policy(app: dash.Dash) -> str:
    """The Content-Security-Policy of all pages: scripts of this server and Dash's own line alone, none made of text."""
    scripts = " ".join(["'self'", *app.csp_hashes()])
    return (
        f"default-src 'self'; script-src {scripts}; style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; "
        "worker-src 'self' blob:; object-src 'none'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    )


def _with_headers(response: flask.Response, policy: str) -> flask.Response:
    """Headers by which a browser loads nothing from elsewhere, and shows the page in no frame."""
    response.headers["Content-Security-Policy"] = policy
    response.headers.update(HEADERS)
    return response


def _add_routes(server: flask.Flask, studio: Studio) -> None:
    """Uploads and downloads."""

    def answered(act: Callable[[OpenCase], Any], name: str) -> Any:
        opened = studio.case(name)
        if opened is None:
            return flask.Response("There is no such case here.", status=404)
        try:
            return act(opened)
        except AlulaError as error:
            return flask.Response(str(error), status=400)

    def upload(name: str) -> Any:
        return answered(_receive_log, name)

    def upload_vehicle(name: str) -> Any:
        return answered(_receive_vehicle, name)

    def upload_effects(name: str) -> Any:
        return answered(_receive_effects, name)

    def download_vehicle(name: str, number: int) -> Any:
        return answered(lambda opened: _vehicle_file(opened, number), name)

    def download_archive(name: str) -> Any:
        return answered(_archive, name)

    def download_script(name: str) -> Any:
        return answered(_script, name)

    def upload_archive() -> Any:
        return _receive_archive(studio)

    drawing = threading.Lock()  # one browser at a time

    def save_picture() -> Any:
        try:
            with drawing:
                return flask.Response(_picture(), mimetype="application/pdf")
        except AlulaError as error:
            return flask.Response(str(error), status=400)

    server.add_url_rule("/picture.pdf", view_func=save_picture, methods=["POST"])
    server.add_url_rule("/case/<name>/upload", view_func=upload, methods=["PUT"])
    server.add_url_rule("/case/<name>/vehicle", view_func=upload_vehicle, methods=["PUT"])
    server.add_url_rule("/case/<name>/effects", view_func=upload_effects, methods=["PUT"])
    server.add_url_rule("/case/<name>/vehicle/<int:number>.toml", view_func=download_vehicle)
    server.add_url_rule("/case/<name>/archive", view_func=download_archive)
    server.add_url_rule("/case/<name>/script.sh", view_func=download_script)
    server.add_url_rule("/archive", view_func=upload_archive, methods=["PUT"])


def _receive_log(opened: OpenCase) -> str:
    """Stream an uploaded log to the case's folder; only one chunk of it is ever in memory."""
    path = opened.case.new_log_path(flask.request.args.get("name", "log"))
    write_whole(path, _stream_to, advice="Make room on the disk.")
    opened.case.add_logs([path])
    opened.start("check")
    return path.name


def _stream_to(part: Path) -> None:
    """Write the request's body to a file. Raises OSError where the browser ended it before its time."""
    expected, size = flask.request.content_length, 0
    with part.open("wb") as file:
        try:
            while chunk := flask.request.stream.read(CHUNK):
                file.write(chunk)
                size += len(chunk)
        except ClientDisconnected as error:
            raise OSError(f"the upload ended after {size} of {expected} bytes") from error
    if expected is not None and size != expected:
        raise OSError(f"the upload ended after {size} of {expected} bytes")


def _text() -> str:
    """The request's body as text. Raises RequestError for one that is none."""
    body = flask.request.stream.read(MAX_TEXT + 1)
    if len(body) > MAX_TEXT:
        raise RequestError(f"the file has more than {MAX_TEXT >> 20} MB; a vehicle or effect file is text.")
    try:
        return str(body, "utf-8")
    except UnicodeDecodeError as error:
        raise RequestError(f"the file is no text: {error}. Give a TOML or Python file.") from error


def _receive_vehicle(opened: OpenCase) -> str:
    name = Path(flask.request.args.get("name", "vehicle.toml")).name
    folder = opened.case.folder
    text = with_effect_files(_text(), folder, [file.path for file in opened.case.effect_files()])
    target = folder / f"uploaded_{name}"
    action = f"chose {Path(name).stem}"
    opened.choose_vehicle(lambda: opened.case.set_vehicle_text(text, source=str(target), action=action))
    write_whole(target, lambda part: part.write_text(text, encoding="utf-8"), advice="Make room on the disk.")
    if opened.case.state.logs:
        opened.start("check")
        opened.start_if_open("compare")
    return name


def _receive_effects(opened: OpenCase) -> str:
    name = Path(flask.request.args.get("name", "effects.py")).name
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / name
        path.write_text(_text(), encoding="utf-8")
        opened.case.add_effect_file(path)
    if opened.case.state.logs:
        opened.start("check")
    return name


def _picture() -> bytes:
    """The picture of a request as PDF. Raises RequestError for one that is none, or cannot be drawn."""
    from studio.pages.picture_files import picture_pdf

    body = flask.request.stream.read(MAX_FIGURE + 1)
    if len(body) > MAX_FIGURE:
        raise RequestError(f"the picture has more than {MAX_FIGURE >> 20} MB. Zoom in, or save it as PNG.")
    try:
        figure = decode_json(body, SavedFigure)
    except (msgspec.MsgspecError, UnicodeDecodeError) as error:
        raise RequestError(f"that is no picture: {described(error)}. Send data, layout, width and height.") from None
    return picture_pdf({"data": figure.data, "layout": figure.layout}, width=figure.width, height=figure.height)


def _vehicle_file(opened: OpenCase, number: int) -> Any:
    version = opened.case.version_number(number)
    if version is None:
        raise RequestError(f"the case has no version {number}.")
    name = f"{opened.case.vehicle_name(version)}.v{number}.toml"
    return flask.send_file(opened.case.vehicle_path(version), as_attachment=True, download_name=name)


def _script(opened: OpenCase) -> Any:
    """The way to the present version as a shell script."""
    headers = {"Content-Disposition": f"attachment; filename={secure_filename(opened.case.state.name) or 'case'}.sh"}
    return flask.Response(script(opened.case), mimetype="text/x-shellscript", headers=headers)


def _archive(opened: OpenCase) -> Any:
    """The case as one file, which is removed when it has been sent."""
    folder = Path(tempfile.mkdtemp())
    path = write_archive(opened.case, folder / f"case{ENDING}")
    response = flask.send_file(path, as_attachment=True, download_name=f"{opened.case.state.name}{ENDING}")
    response.call_on_close(lambda: shutil.rmtree(folder, ignore_errors=True))
    return response


def _receive_archive(studio: Studio) -> Any:
    name = Path(flask.request.args.get("name", "case")).name.removesuffix(ENDING)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"case{ENDING}"
        try:
            write_whole(path, _stream_to, advice="Make room on the disk.")
            return studio.unpack(path, name)
        except AlulaError as error:
            return flask.Response(str(error), status=400)
