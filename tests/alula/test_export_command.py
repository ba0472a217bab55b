"""`alula export` from the outside: a bundle or a reason, never a traceback."""

import json
from pathlib import Path

import pytest

from tests.support.command_line import Run, command_line


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    return command_line(monkeypatch, capsys)


def test_a_vehicle_file_becomes_a_bundle_once(run: Run, tmp_path: Path) -> None:
    out = str(tmp_path / "bundle")
    code, shown, wrong = run("export", "arpl_250g", "--out", out, "--windows", "20", "--json")
    assert code == 0, wrong
    assert all(row["error"] <= row["tolerance"] for row in json.loads(shown)["comparisons"])
    written = {path.name for path in (tmp_path / "bundle").iterdir()}
    assert {"model.onnx", "model.c", "model.h", "kernel.so", "vehicle.toml", "manifest.json", "parity.json"} <= written
    assert "alula export arpl_250g" in json.loads((tmp_path / "bundle" / "manifest.json").read_text())["command"]
    code, _, wrong = run("export", "arpl_250g", "--out", out)
    assert code == 2
    assert "--overwrite" in wrong


def test_what_is_no_model_is_refused(run: Run, tmp_path: Path) -> None:
    (tmp_path / "noise.pt").write_bytes(b"noise")
    for model, message in (("nothing.pt", "there is no"), (str(tmp_path / "noise.pt"), "no checkpoint")):
        code, _, wrong = run("export", model, "--out", tmp_path / "b")
        assert code == 2
        assert message in wrong
    code, _, wrong = run("export", "arpl_250g", "--out", tmp_path / "b", "--processor", "abacus")
    assert code == 2
    assert "unknown processor" in wrong
