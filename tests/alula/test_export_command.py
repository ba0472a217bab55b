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


def test_a_bundle_is_verified_where_it_lies(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("runtime.control.verification.Timing.holds", True)  # a busy machine is slow
    out = tmp_path / "bundle"
    assert run("export", "arpl_250g", "--out", out, "--windows", "10")[0] == 0
    code, shown, wrong = run("export", "--verify", out)
    assert code == 0, wrong
    assert "kernel.so: solution as at the export to 0.0e+00" in shown
    assert "next: alula fly --bundle" in shown
    with (out / "ticks.npz").open("ab") as file:
        file.write(b"edited")
    for arguments, message in (
        (("--verify", out), "ticks.npz is not the file that was exported"),
        (("arpl_250g", "--verify", out), "leave MODEL and --out out"),
        (("arpl_250g",), "give MODEL and --out FOLDER, or --verify BUNDLE"),
    ):
        code, _, wrong = run("export", *arguments)
        assert code == 2
        assert message in wrong
