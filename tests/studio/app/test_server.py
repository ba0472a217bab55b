"""The server's door: who may come in, what is uploaded, and a port that is taken."""

from __future__ import annotations

import io
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from flask.testing import FlaskClient

import alula
from dynamics.effect_source import sha256_of
from dynamics.errors import RequestError
from dynamics.trust import approve_here
from studies.results.read import RESULTS
from studio.app.door import Owner
from studio.app.server import MAX_FIGURE, PORT, make_app, serve
from studio.app.studio import Studio, default_root
from vehicles import FOLDER

OWN_EFFECTS = Path(__file__).parents[3] / "examples" / "my_effects.py"
BUNDLED = (FOLDER / "arpl_250g.toml").read_text(encoding="utf-8")
TOKEN = "a-token-of-these-tests"
BASE = f"http://127.0.0.1:{PORT}"


@pytest.fixture(scope="module")
def studio(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Studio]:
    room = Studio(tmp_path_factory.mktemp("cases"), RESULTS)
    yield room
    room.close()


@pytest.fixture(scope="module")
def client(studio: Studio) -> FlaskClient:
    client: FlaskClient = make_app(studio, PORT, Owner(TOKEN)).server.test_client()
    client.get(f"/?token={TOKEN}", base_url=BASE)  # becomes a cookie
    return client


def _get(client: FlaskClient, path: str = "/", **headers: str) -> Any:
    return client.get(path, base_url=BASE, headers=headers)


def test_the_page_comes_and_loads_nothing_from_a_network(client: FlaskClient) -> None:
    answer = _get(client)
    assert answer.status_code == 200
    assert "https://" not in answer.get_data(as_text=True).replace("https://github.com", "")
    policy = answer.headers["Content-Security-Policy"]
    assert "default-src 'self'" in policy
    assert "unsafe-eval" not in policy
    assert "unsafe-inline" not in policy.partition("script-src")[2].partition(";")[0]


@pytest.mark.parametrize("host", ["evil.example", f"evil.example:{PORT}", "127.0.0.1:1", "127.0.0.1"])
def test_a_foreign_host_is_refused(client: FlaskClient, host: str) -> None:
    answer = client.get("/", base_url=f"http://{host}", headers={"Authorization": f"Bearer {TOKEN}"})
    assert answer.status_code == 403


@pytest.mark.parametrize("origin", ["http://evil.example", "null", f"https://127.0.0.1:{PORT}"])
@pytest.mark.parametrize("method", ["get", "post", "put"])
def test_a_request_from_another_origin_is_refused(client: FlaskClient, origin: str, method: str) -> None:
    call = getattr(client, method)
    assert call("/_dash-update-component", base_url=BASE, headers={"Origin": origin}).status_code == 403
    assert call("/", base_url=BASE, headers={"Sec-Fetch-Site": "cross-site"}).status_code == 403


def test_our_own_page_may_ask(client: FlaskClient) -> None:
    assert _get(client, "/_dash-layout", Origin=BASE).status_code == 200


def test_an_upload_is_streamed_into_the_case(client: FlaskClient, studio: Studio, ulogs: list[Path]) -> None:
    name = studio.create(name="upload")
    with ulogs[0].open("rb") as file:
        answer = client.put(f"/case/{name}/upload?name=..%2F..%2Fflight.ulg", base_url=BASE, input_stream=file,
                            content_length=ulogs[0].stat().st_size)  # fmt: skip
    assert answer.status_code == 200
    opened = studio.case(name)
    assert opened is not None
    opened.wait(120.0)
    (path,) = opened.case.log_paths
    assert path.parent == opened.case.folder / "logs"
    assert path.name == "flight.ulg"
    assert path.read_bytes() == ulogs[0].read_bytes()


def test_an_upload_that_ends_before_its_time_leaves_nothing(client: FlaskClient, studio: Studio) -> None:
    name = studio.create(name="cut off")
    opened = studio.case(name)
    assert opened is not None
    answer = client.put(
        f"/case/{name}/upload?name=flight.ulg",
        base_url=BASE,
        input_stream=io.BytesIO(b"ULog"),
        environ_overrides={"CONTENT_LENGTH": "1000"},
    )
    assert answer.status_code == 400
    assert not opened.case.state.logs
    assert not list((opened.case.folder / "logs").iterdir())


def test_a_vehicle_file_that_cannot_be_used_is_refused_with_its_message(client: FlaskClient, studio: Studio) -> None:
    name = studio.create(name="vehicle")
    answer = client.put(f"/case/{name}/vehicle?name=v.toml", base_url=BASE, data=b"name = 3")
    assert answer.status_code == 400
    assert answer.get_data(as_text=True)
    assert client.put(f"/case/{name}/vehicle?name=v.toml", base_url=BASE, data=b"\xff\xfe").status_code == 400


def test_an_effect_file_without_an_effect_is_refused(client: FlaskClient, studio: Studio) -> None:
    name = studio.create(name="effects")
    approve_here([("effects", sha256_of("x = 1"))])
    answer = client.put(f"/case/{name}/effects?name=e.py", base_url=BASE, data=b"x = 1")
    assert answer.status_code == 400
    assert "my_effects.py" in answer.get_data(as_text=True)


@pytest.mark.usefixtures("nothing_approved")
def test_uploaded_effects_run_once_their_content_is_approved(
    client: FlaskClient, studio: Studio, tmp_path: Path
) -> None:
    name = studio.create(name="own effects")
    opened = studio.case(name)
    assert opened is not None
    text = f"import pathlib\npathlib.Path({str(tmp_path / 'RAN')!r}).touch()\n{OWN_EFFECTS.read_text()}"
    address = f"/case/{name}/effects?name=e.py"
    answer = client.put(address, base_url=BASE, data=text.encode())
    place = opened.case.folder / "effects" / "e.py"
    assert (answer.status_code, place.read_text()) == (400, text)
    assert f"`alula trust {place}`" in answer.get_data(as_text=True)
    assert opened.case.state.effect_files == ()
    vehicle = f'effect_files = ["effects/e.py"]\n{BUNDLED}'
    assert client.put(f"/case/{name}/vehicle?name=v.toml", base_url=BASE, data=vehicle.encode()).status_code == 400
    assert not (tmp_path / "RAN").exists()
    alula.trust(place)
    assert client.put(address, base_url=BASE, data=text.encode()).status_code == 200
    assert opened.case.state.effect_files == ("effects/e.py",)
    assert (tmp_path / "RAN").exists()


def test_versions_and_cases_are_downloaded(client: FlaskClient, studio: Studio) -> None:
    name = studio.create(name="download")
    opened = studio.case(name)
    assert opened is not None
    opened.case.set_vehicle("px4_sih")
    answer = _get(client, f"/case/{name}/vehicle/1.toml")
    assert answer.status_code == 200
    assert b"px4_sih" in answer.data
    answer.close()
    assert _get(client, f"/case/{name}/vehicle/7.toml").status_code == 400
    sent = _get(client, f"/case/{name}/archive")
    packed = sent.data
    sent.close()
    unpacked = client.put("/archive?name=sent.alula.zip", base_url=BASE, data=packed)
    assert unpacked.status_code == 200
    again = studio.case(unpacked.get_data(as_text=True))
    assert again is not None
    assert again.case.vehicle().name == "px4_sih"
    assert client.put("/archive?name=sent.alula.zip", base_url=BASE, data=b"no zip").status_code == 400


def _save(client: FlaskClient, body: bytes) -> Any:
    return client.post("/picture.pdf", base_url=BASE, data=body)


@pytest.mark.parametrize(
    ("body", "message"),
    [
        (b"none", "that is no picture: JSON is malformed"),
        (b'{"data": [], "layout": {}, "width": 700}', "'height' is missing"),
        (b'{"data": [], "layout": {}, "width": 700, "height": 0}', "height must be a whole number at least 1"),
        (b" " * (MAX_FIGURE + 1), "more than 64 MB"),
    ],
)
def test_what_is_no_picture_is_not_drawn(client: FlaskClient, body: bytes, message: str) -> None:
    answer = _save(client, body)
    assert answer.status_code == 400
    assert message in answer.get_data(as_text=True)


def test_a_picture_cannot_be_printed_without_what_prints(client: FlaskClient, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "kaleido", None)
    answer = _save(client, b'{"data": [], "layout": {}, "width": 700, "height": 300}')
    assert answer.status_code == 400
    assert "[workbench]'" in answer.get_data(as_text=True)


def test_an_unknown_case_is_no_page(client: FlaskClient) -> None:
    assert _get(client, "/case/nothing/archive").status_code == 404


def test_a_port_that_is_taken_is_refused_and_the_usual_one_gives_way(studio: Studio) -> None:
    server, address = serve(studio, port=0)
    port = int(address.rsplit(":", 1)[1].strip("/"))
    try:
        with pytest.raises(RequestError, match=f"port {port} cannot be used"):
            serve(studio, port=port)
    finally:
        server.server_close()
    first, one = serve(studio)
    second, other = serve(studio)
    first.server_close()
    second.server_close()
    assert one != other


def test_two_cases_do_not_mix(studio: Studio, ulogs: list[Path]) -> None:
    names = [studio.create(name="same name"), studio.create(name="same name")]
    first, second = (studio.case(name) for name in names)
    assert first is not None
    assert second is not None
    first.case.add_logs(ulogs[:1])
    assert not second.case.state.logs
    assert first.case.folder != second.case.folder


def test_cases_are_made_where_the_desktop_keeps_data(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    assert default_root() == tmp_path / "alula" / "cases"
