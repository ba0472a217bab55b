"""The flight check of an exported network, and the warning that `alula fly` repeats."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from dynamics.errors import RequestError
from dynamics.vehicle import Vehicle
from runtime.control.bundle import read_bundle
from simulation.flight_check import FILE, check_flight, read_check
from tests.support.command_line import Run, command_line
from tests.support.trained import replaced, untrained_model
from training.checkpoint import save
from training.models import KINDS


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    return command_line(monkeypatch, capsys)


def checkpoint(vehicle: Vehicle, folder: Path, gain: float) -> Path:
    """A small residual on the nominal model. gain: 0.002 is almost nothing, 1 a large force that does not exist."""
    config = replaced(KINDS["res_tcn"].config, channels=8, hidden=(16,))
    save(untrained_model(config, vehicle, gain=gain), folder / "model.pt")
    return folder / "model.pt"


def test_a_network_that_holds_the_flight_is_reported_with_its_error(
    run: Run, tmp_path: Path, arpl_250g: Vehicle
) -> None:
    model, out = checkpoint(arpl_250g, tmp_path, 0.002), tmp_path / "bundle"
    code, shown, wrong = run("export", model, "--out", out, "--windows", "20")
    assert code == 0, wrong
    assert "flight check: 9.0 s of Ellipse_1:laps=1" in shown
    check = read_check(out)
    assert check is not None
    assert check.held
    assert check.away == 0.0
    assert check.position_rmse is not None
    assert 0.0 < check.position_rmse < 0.03
    assert check == check_flight(read_bundle(out))  # the same inputs, the same flight; and the bundle is still one


def test_a_network_that_does_not_is_exported_with_a_warning_that_flying_repeats(
    run: Run, tmp_path: Path, arpl_250g: Vehicle
) -> None:
    model, out = checkpoint(arpl_250g, tmp_path, 1.0), tmp_path / "bundle"
    code, shown, wrong = run("export", model, "--out", out, "--windows", "20", "--json")
    assert code == 0, wrong
    answer = json.loads(shown)
    assert answer["comparisons"]
    assert not answer["flight_check"]["held"]
    assert answer["flight_check"]["away"] > 0.5
    assert "--input-noise" in answer["flight_check"]["warning"]
    assert json.loads((out / FILE).read_text()) == answer["flight_check"]
    code, shown, _ = run(
        "fly", "--bundle", out, "--reference", "hover", "--link", "udpin:127.0.0.1:14997", "--timeout", 0.1
    )
    assert code == 4  # there is no vehicle
    assert "warning: the network itself did not hold a simulated flight" in shown
    (out / FILE).write_text("{")
    with pytest.raises(RequestError, match="export the model again"):
        read_check(out)
    (out / FILE).unlink()
    assert read_check(out) is None


def test_the_flight_can_be_left_out_and_physics_needs_none(run: Run, tmp_path: Path, arpl_250g: Vehicle) -> None:
    model, out = checkpoint(arpl_250g, tmp_path, 0.002), tmp_path / "bundle"
    code, shown, wrong = run("export", model, "--out", out, "--windows", "20", "--json", "--no-flight-check")
    assert code == 0, wrong
    assert json.loads(shown)["flight_check"] is None
    assert not (out / FILE).exists()
    code, shown, wrong = run("export", "arpl_250g", "--out", tmp_path / "physics", "--windows", "20", "--json")
    assert code == 0, wrong
    assert json.loads(shown)["flight_check"] is None
