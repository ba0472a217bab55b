"""Data never runs code: every command with every kind of file that names or carries Python, and `alula trust`."""

import shutil
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path

import msgspec
import pytest
import torch

import alula
from alula.cli import app
from dynamics import trust
from dynamics.effect_source import effect_file, read_effect_file, tables_toml
from dynamics.vehicle_file import parse_vehicle
from runtime.flight.mission import Plan
from runtime.record.files import McapFile, SafeFile
from tests.support.trained import untrained_model
from training.checkpoint import save
from training.models import named_kind
from vehicles import FOLDER

BUNDLED = (FOLDER / "arpl_250g.toml").read_text(encoding="utf-8")
EXAMPLE = Path(__file__).parents[2] / "examples" / "my_effects.py"
Ended = tuple[int, str, str]
pytestmark = pytest.mark.usefixtures("nothing_approved")


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Callable[..., Ended]:
    """Run the command line as in a process of its own; returns exit code, standard output, standard error."""

    def ended(*arguments: object) -> Ended:
        monkeypatch.setattr(trust, "_approved", set())
        monkeypatch.setattr(sys, "argv", ["alula", *map(str, arguments)])
        with pytest.raises(SystemExit) as caught:
            app.main()
        return (int(caught.value.code or 0), *capsys.readouterr())

    return ended


@pytest.fixture
def payload(tmp_path: Path) -> str:
    """A good effect file that leaves a file behind when it runs."""
    return f"import pathlib\npathlib.Path({str(tmp_path / 'RAN')!r}).touch()\n{EXAMPLE.read_text()}"


def _write_mcap(path: Path, metadata: dict[str, str], attachments: dict[str, str]) -> None:
    file = SafeFile(path)
    McapFile(file, metadata, attachments).finish()
    file.close()


def _polyglot(path: Path, payload: str) -> None:
    """A recording with a program at its end, as Python runs archives."""
    _write_mcap(path, {}, {})
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr("__main__.py", payload)


@pytest.fixture
def place(tmp_path: Path, payload: str, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A downloaded folder, the working directory; the program lies in it, above it, and in a link."""
    folder = tmp_path / "downloaded"
    folder.mkdir()
    for program in (folder / "evil.py", tmp_path / "evil.py"):
        program.write_text(payload)
    (folder / "link.py").symlink_to(tmp_path / "evil.py")
    _polyglot(folder / "flight.mcap", payload)
    (folder / "log.csv").write_text("t\n1\n")
    monkeypatch.chdir(folder)
    return folder


KINDS = {  # of vehicle files: what they hold as effect_files, and the refusal
    "beside": ('["evil.py"]', "you have not approved"),
    "whole path": ('["{folder}/evil.py"]', "does not lie beside"),
    "above": ('["../evil.py"]', "does not lie beside"),
    "link out": ('["link.py"]', "does not lie beside"),
    "archive": ('["flight.mcap"]', "is no file with effects"),
    "text": ("", "you have not approved"),
}
COMMANDS = {
    "vehicle show": "vehicle show {v}",
    "vehicle check": "vehicle check log.csv --vehicle {v}",
    "effects": "effects --vehicle {v}",
    "diagnose": "diagnose log.csv --vehicle {v}",
    "fleet": "diagnose --fleet . --vehicle {v}",
    "compare": "compare log.csv --vehicle {v}",
    "add": "add log.csv --vehicle {v}",
    "prove": "prove log.csv --vehicle {v} --before arpl_250g",
    "prove before": "prove log.csv --vehicle arpl_250g --before {v}",
    "train": "train log.csv --vehicle {v} --model nominal --out m.pt",
    "export": "export {v} --out b",
    "mock": "mock --vehicle {v}",
    "campaign": "campaign --vehicle {v} --out c --flights test",
    "fly": "fly --vehicle {v} --reference hover --timeout 0.1",
    "link": "link --vehicle {v} --timeout 0.1",
    "sweep": "sweep kinds log.csv --vehicle {v} --out s --test log.csv",
    "replay": "replay old.mcap --vehicle {v}",
    "bundle folder": "fly --bundle . --reference hover --timeout 0.1",
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("command", COMMANDS)
def test_no_command_runs_what_a_vehicle_file_names(
    run: Callable[..., Ended], place: Path, payload: str, tmp_path: Path, command: str, kind: str
) -> None:
    names, refusal = KINDS[kind]
    text = f"effect_files = {names.format(folder=place)}\n{BUNDLED}" if names else BUNDLED
    text += "" if names else tables_toml([effect_file("evil.py", payload)])
    (place / "vehicle.toml").write_text(text)
    recording(place / "old.mcap", BUNDLED)
    code, _, error = run(*COMMANDS[command].format(v="vehicle.toml").split())
    assert (code, refusal in error) == (2, True), error
    assert not (tmp_path / "RAN").exists()


def recording(path: Path, vehicle: str, attachments: dict[str, str] | None = None) -> None:
    """A recording of no ticks with a vehicle file."""
    metadata = {"reference": "hover", "plan": msgspec.json.encode(Plan(height=1.0)).decode()}
    _write_mcap(path, metadata, {"vehicle.toml": vehicle, **(attachments or {})})


@pytest.mark.parametrize("names", ['["flight.mcap"]', '["{folder}/evil.py"]', '["../evil.py"]', "text", "attachment"])
@pytest.mark.parametrize("command", ["replay {r}", "replay ."])
def test_no_recording_runs_what_it_names_or_carries(
    run: Callable[..., Ended], place: Path, payload: str, tmp_path: Path, names: str, command: str
) -> None:
    (place / "flight.mcap").unlink()
    named = f"effect_files = {names.format(folder=place)}\n{BUNDLED}"
    carried = BUNDLED + tables_toml([effect_file("/home/u/evil.py", payload)])
    old = f'effect_files = ["{place}/evil.py"]\n{BUNDLED}'
    attachments = {"effects/evil.py": payload} if names == "attachment" else {}
    recording(place / "flight.mcap", {"text": carried, "attachment": old}.get(names, named), attachments)
    with zipfile.ZipFile(place / "flight.mcap", "a") as archive:
        archive.writestr("__main__.py", payload)
    code, _, error = run(*command.format(r="flight.mcap").split())
    assert code == 2, error
    assert "does not hold it" in error or "you have not approved" in error, error
    if names in ("text", "attachment"):
        assert code == 2
        assert "alula trust flight.mcap" in error
        assert effect_file("evil.py", payload).sha256 in error
    assert not (tmp_path / "RAN").exists()


def test_a_recording_is_replayed_with_effects_that_are_approved(
    run: Callable[..., Ended], place: Path, payload: str
) -> None:
    recording(place / "flown.mcap", BUNDLED + tables_toml([effect_file("evil.py", payload)]))
    refused = "you have not approved"
    assert refused in run("replay", "flown.mcap")[2]
    assert refused not in run("replay", "flown.mcap", "--effects", "evil.py")[2]
    assert refused in run("replay", "flown.mcap")[2]  # that was for one call
    code, shown, _ = run("trust", "flown.mcap")
    assert code == 0
    assert all(line in shown for line in payload.splitlines()[:40])
    assert refused not in run("replay", "flown.mcap")[2]


@pytest.fixture
def checkpoint(place: Path, payload: str, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A model that was trained with an effect of somebody's own."""
    text = BUNDLED + tables_toml([effect_file("/home/u/evil.py", payload)])
    monkeypatch.setattr(trust, "_approved", {("effects", effect_file("", payload).sha256)})
    save(untrained_model(named_kind("pi_mlp").config, parse_vehicle(text)), place / "m.pt")
    (place.parent / "RAN").unlink(missing_ok=True)
    return place / "m.pt"


def test_approval_is_for_the_content_not_for_the_name(run: Callable[..., Ended], place: Path, tmp_path: Path) -> None:
    (place / "v.toml").write_text(f'effect_files = ["evil.py"]\n{BUNDLED}')
    code, _, error = run("vehicle", "show", "v.toml")
    assert code == 2
    assert f"`alula trust {place}/evil.py`" in error
    code, shown, _ = run("trust", place / "evil.py")
    assert code == 0
    assert read_effect_file(place / "evil.py").sha256 in shown
    assert not (tmp_path / "RAN").exists()  # approving runs nothing
    assert run("vehicle", "show", "v.toml")[0] == 0
    assert (tmp_path / "RAN").exists()
    assert str(place / "evil.py") in run("trust", "--list")[1]
    (place / "evil.py").write_text("raise SystemExit('ran')\n")
    assert run("vehicle", "show", "v.toml")[0] == 2
    assert run("trust", "--remove", "evil.py")[0] == 0
    assert "nothing is approved" in run("trust", "--list")[1]


def test_effects_of_one_call_are_approved_for_it_alone(run: Callable[..., Ended], place: Path, payload: str) -> None:
    (place / "v.toml").write_text(f'effect_files = ["evil.py", "other.py"]\n{BUNDLED}')
    (place / "other.py").write_text("EFFECTS = []\n")
    code, _, error = run("vehicle", "show", "v.toml", "--effects", "evil.py")
    assert code == 2
    assert "other.py" in error
    (place / "v.toml").write_text(f'effect_files = ["evil.py"]\n{BUNDLED}')
    assert run("vehicle", "show", "v.toml", "--effects", "evil.py")[0] == 0
    assert run("vehicle", "show", "v.toml")[0] == 2


def test_python_approves_by_naming_the_files(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(trust, "_approved", set())
    (place / "v.toml").write_text(f'effect_files = ["evil.py"]\n{BUNDLED}')
    with pytest.raises(alula.RequestError, match="you have not approved"):
        alula.load_vehicle("v.toml")
    assert [file.name for file in alula.load_vehicle("v.toml", effect_files=["evil.py"]).effect_files] == ["evil.py"]
    monkeypatch.setattr(trust, "_approved", set())
    (trusted,) = alula.trust("v.toml")
    assert trusted.sha256 == read_effect_file(place / "evil.py").sha256
    assert alula.load_vehicle("v.toml").effect_files


def test_a_vehicle_with_its_texts_is_read_wherever_it_lies(place: Path, tmp_path: Path) -> None:
    vehicle = alula.load_vehicle("arpl_250g", effect_files=["evil.py"])
    alula.write_vehicle(vehicle, tmp_path / "moved.toml")
    shutil.rmtree(place)
    assert [f.sha256 for f in alula.load_vehicle(tmp_path / "moved.toml").effect_files] == [
        f.sha256 for f in vehicle.effect_files
    ]


def test_a_checkpoint_is_read_only_where_its_effects_are_approved(
    run: Callable[..., Ended], checkpoint: Path, tmp_path: Path
) -> None:
    for command in (f"evaluate {checkpoint} log.csv", f"export {checkpoint} --out b"):
        code, _, error = run(*command.split())
        assert code == 2
        assert f"alula trust {checkpoint}" in error
    assert not (tmp_path / "RAN").exists()
    assert "import pathlib" in run("trust", checkpoint)[1]
    assert "you have not approved" not in run("evaluate", checkpoint, "log.csv")[2]
    assert torch.load(checkpoint, weights_only=True)["vehicle"].count("sha256") == 1


@pytest.mark.parametrize("words", [(), ("log.csv",), ("absent.py",), ("--remove", "evil.py"), ("--list", "evil.py")])
def test_what_cannot_be_approved_is_refused(run: Callable[..., Ended], place: Path, words: tuple[str, ...]) -> None:
    assert run("trust", *words)[0] == 2
    assert "nothing is approved" in run("trust", "--list")[1]
