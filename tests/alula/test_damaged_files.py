"""Damaged files end a command with a message and its exit code, never with a traceback."""

from __future__ import annotations

import random
from pathlib import Path

import msgspec
import pytest
import torch

from dynamics.errors import AlulaError, RequestError
from runtime.control.bundle import MANIFEST, read_bundle
from runtime.record.recording import damage_named, read_recording
from studio.case.case import Case
from studio.case.state_file import STATE_FILE
from tests.support.command_line import Run, command_line
from training.checkpoint import load
from vehicles import FOLDER

RECORDED = Path(__file__).parents[1] / "data" / "recorded_flight" / "flight.mcap"
NO_UTF8 = b'{"format": "\xff\xfe", "name": "\xe9"}'


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    return command_line(monkeypatch, capsys)


@pytest.mark.parametrize("seed", range(4))
def test_a_damaged_recording_is_read_up_to_there_or_refused(seed: int, tmp_path: Path) -> None:
    intact, draw = RECORDED.read_bytes(), random.Random(seed)
    for turn in range(6):
        content = bytearray(intact)
        if turn % 2:
            del content[draw.randrange(len(content)) :]
        else:
            for _ in range(20):
                content[draw.randrange(len(content))] ^= 1 << draw.randrange(8)
        file = tmp_path / f"damaged_{turn}.mcap"
        file.write_bytes(content)
        try:
            read_recording(file)
        except AlulaError as error:
            assert str(file) in str(error)  # noqa: PT017


@pytest.mark.parametrize(
    ("place", "content"),
    [
        ("plan", "{"),
        ("plan", '{"height": "high"}'),
        ("settings", "[]"),
        ("controller", '{"nodes": -1'),
        ("reference", "no such manoeuvre"),
        ("vehicle.toml", "mass = \x00"),
        ("vehicle.toml", ""),
        ("manifest.json", "{"),
    ],
)
def test_a_recording_with_damaged_parts_is_no_traceback(
    place: str, content: str, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    read = read_recording(RECORDED)
    parts = dict(read.attachments) if "." in place else dict(read.metadata)
    parts[place] = content
    changed = {"attachments" if "." in place else "metadata": parts}
    fields = {name: getattr(read, name) for name in read.__dataclass_fields__}
    monkeypatch.setattr("alula.cli.replay.read_recording", lambda _: type(read)(**{**fields, **changed}))
    code, _, wrong = run("replay", RECORDED)
    assert code in (2, 3), wrong
    assert wrong.startswith("alula: ")


def test_a_recordings_row_of_another_kind_is_named(tmp_path: Path) -> None:
    for error in (KeyError("x"), TypeError("x"), msgspec.DecodeError("x"), UnicodeDecodeError("utf-8", b"", 0, 1, "x")):
        with pytest.raises(AlulaError, match=r"one\.mcap is damaged"), damage_named(tmp_path / "one.mcap"):
            raise error


def test_a_file_as_a_case_is_refused(run: Run, tmp_path: Path) -> None:
    file = tmp_path / "flight.csv"
    file.write_text("t\n")
    code, _, wrong = run("studio", "--case", file, "--no-browser", "--cases", tmp_path / "cases")
    assert code == 2
    assert f"{file} is a file" in wrong or "holds no case" in wrong
    code, _, wrong = run("studio", file, "--case", file, "--no-browser", "--cases", tmp_path / "cases")
    assert code == 2
    assert f"{file} is a file" in wrong


@pytest.mark.parametrize("content", [NO_UTF8, b"", b"[]", b"null", b"\x00", b'{"format": 1, "name": 3}'])
def test_a_damaged_case_is_refused(content: bytes, tmp_path: Path) -> None:
    (tmp_path / STATE_FILE).write_bytes(content)
    with pytest.raises(RequestError, match="case"):
        Case.open(tmp_path)


@pytest.mark.parametrize("content", [NO_UTF8, b"", b"[]", b"null", b"\x00", b'{"kind": 3}'])
def test_a_damaged_manifest_is_refused(content: bytes, tmp_path: Path) -> None:
    (tmp_path / MANIFEST).write_bytes(content)
    with pytest.raises(RequestError, match="damaged"):
        read_bundle(tmp_path)


@pytest.mark.parametrize("wrong", [None, 3, "text", [], {}, [[]], {"a": None}])
def test_a_checkpoint_with_a_wrong_or_missing_entry_is_refused(wrong: object, tmp_path: Path) -> None:
    content = torch.load(FOLDER / "arpl_250g.pi_mlp.pt", map_location="cpu", weights_only=True)
    for name in ("config", "members", "scaling", "ranges", "vehicle", "card"):
        changed = {**content, name: wrong}
        if wrong is None:
            del changed[name]
        torch.save(changed, tmp_path / "model.pt")
        with pytest.raises(RequestError, match=r"model\.pt"):
            load(tmp_path / "model.pt")


class Removed:
    """A class that the file names and this alula lacks."""


def test_a_checkpoint_that_names_what_is_not_there_is_refused(tmp_path: Path) -> None:
    torch.save({"format": Removed()}, tmp_path / "model.pt")
    with pytest.raises(RequestError, match=r"model\.pt is no checkpoint"):
        load(tmp_path / "model.pt")
