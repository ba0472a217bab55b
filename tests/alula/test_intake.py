"""Folders of logs as users have them: notes and results beside the logs, and the vehicle file, which is used."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

import alula
from alula.api.inputs import log_paths
from dynamics.errors import RequestError
from tests.support.command_line import Run, command_line
from training.data.logged_flights import find_logs
from vehicles import FOLDER

LOG = Path(__file__).parents[1] / "data" / "px4_sih_flights" / "drag2_1_circle.ulg.gz"
VEHICLE = FOLDER / "px4_sih.toml"
OTHERS = {
    "notes.txt": b"calm, battery 2, pilot A\nsecond line\n",
    "README.md": b"# flights\n",
    "campaign.json": b'{"kind": "campaign"}\n',
    "photo.jpg": bytes(range(256)) * 8,
    "results.csv": b"name,score\na,1\n",
}
COMMANDS = (  # command, the public function that gets the logs, further words
    ("compare", "compare", ()),
    ("diagnose", "diagnose", ()),
    ("add", "add_effect", ()),
    ("prove", "prove", ("--before", "px4_sih")),
    ("train", "train", ("--model", "pi_tcn", "--out", "m.pt")),
    ("vehicle check", "check_vehicle", ()),
)


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    return command_line(monkeypatch, capsys)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    folder = tmp_path / "logs"
    folder.mkdir()
    shutil.copy(LOG, folder / "flight.ulg.gz")
    shutil.copy(VEHICLE, folder / "vehicle.toml")
    for name, content in OTHERS.items():
        (folder / name).write_bytes(content)
    return folder


def stopped(monkeypatch: pytest.MonkeyPatch, function: str) -> list[tuple[object, ...]]:
    """The arguments that a public function is called with; it ends the command."""
    calls: list[tuple[object, ...]] = []

    def called(*arguments: object, **_: object) -> None:
        calls.append(arguments)
        raise RequestError("far enough.")

    monkeypatch.setattr(alula, function, called)
    return calls


@pytest.mark.parametrize(("name", "function", "more"), COMMANDS, ids=[name for name, *_ in COMMANDS])
def test_a_folder_needs_no_tidying(
    name: str, function: str, more: tuple[str, ...], folder: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls = stopped(monkeypatch, function)
    code, _, wrong = run(*name.split(), folder, *more)
    assert code == 2
    assert wrong.splitlines() == [
        f"vehicle file: {folder / 'vehicle.toml'}, beside the logs",
        "skipped 5 files that are no logs: README.md, campaign.json, notes.txt, photo.jpg, results.csv",
        "alula: far enough.",
    ]
    assert calls[0][:2] == ([folder], str(folder / "vehicle.toml"))


@pytest.mark.parametrize(("name", "function", "more"), COMMANDS, ids=[name for name, *_ in COMMANDS])
def test_of_two_vehicle_files_one_has_to_be_given(
    name: str, function: str, more: tuple[str, ...], folder: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls = stopped(monkeypatch, function)
    shutil.copy(VEHICLE, folder / "vehicle.v2.toml")
    code, _, wrong = run(*name.split(), folder, *more)
    assert code == 2
    assert "vehicle.toml" in wrong
    assert "vehicle.v2.toml" in wrong
    assert "--vehicle" in wrong
    assert not calls
    run(*name.split(), folder, "--vehicle", folder / "vehicle.v2.toml", *more)
    assert calls[0][1] == str(folder / "vehicle.v2.toml")


@pytest.mark.parametrize(("name", "function", "more"), COMMANDS, ids=[name for name, *_ in COMMANDS])
def test_without_any_vehicle_file_it_is_asked_for(
    name: str, function: str, more: tuple[str, ...], folder: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    stopped(monkeypatch, function)
    (folder / "vehicle.toml").unlink()
    code, _, wrong = run(*name.split(), folder, *more)
    assert code == 2
    assert "no --vehicle was given" in wrong
    assert "no vehicle file lies in" in wrong


@pytest.mark.parametrize("command", [("inspect",), ("vehicle", "from-log", "--mass", "1.0")])
def test_a_command_without_a_vehicle_skips_as_well(command: tuple[str, ...], folder: Path, run: Run) -> None:
    code, _, wrong = run(*command[:2], folder, *command[2:]) if len(command) > 1 else run(*command, folder)
    assert "skipped 6 files that are no logs" in wrong
    assert "has no known log format" not in wrong
    assert code == 0 or "from-log" in command


@pytest.mark.parametrize("expand", [log_paths, find_logs])
def test_a_folder_without_a_log_names_what_it_holds(expand: object, folder: Path, run: Run) -> None:
    (folder / "flight.ulg.gz").unlink()
    with pytest.raises(RequestError, match=r"no logs?"):
        expand(folder if expand is log_paths else [folder])  # type: ignore[operator]
    code, _, wrong = run("diagnose", folder)
    assert code == 2
    assert "no log there" in wrong


@pytest.mark.parametrize("name", ["torn.ulg", "torn.mcap", "empty.csv"])
def test_a_damaged_log_is_no_note(name: str, folder: Path) -> None:
    torn = b"ULog\x01\x12\x35\x01" if name == "torn.ulg" else b"\x89MCAP0\r\n" if name == "torn.mcap" else b""
    (folder / name).write_bytes(torn)
    assert name in [path.name for path in log_paths(folder)]


def test_a_campaigns_folder_is_its_training_flights(tmp_path: Path) -> None:
    (tmp_path / "campaign.json").write_text("{}")
    for split in ("train", "test", "truth"):
        (tmp_path / split).mkdir()
        shutil.copy(LOG, tmp_path / split / f"{split}.ulg.gz")
    assert [path.name for path in log_paths(tmp_path)] == ["train.ulg.gz"]
    assert [path.name for path in find_logs([tmp_path])] == ["train.ulg.gz"]
