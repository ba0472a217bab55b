"""Nothing is missing that a Crazyflie's log holds: variables that are not used are kept with range and reason."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from dynamics.arrays import Floats
from flights import Log, read_log
from flights.one_flight import read_one_flight
from flights.quality.inspection import judge
from tests.support.flight_files import Truth, crazyflie_log, manoeuvre


@pytest.fixture(scope="module")
def truth() -> Truth:
    return manoeuvre(duration=12.0, rate=100.0)


def _log(truth: Truth, columns: dict[str, Floats], path: Path, form: str) -> Log:
    named = {
        **{f"stateEstimate.{axis}": truth.position[:, n] for n, axis in enumerate("xyz")},
        **{f"stateEstimate.q{axis}": truth.attitude[:, n] for n, axis in enumerate("wxyz")},
        **{f"gyro.{axis}": np.degrees(truth.rate[:, n]) for n, axis in enumerate("xyz")},
        **columns,
    }
    table = np.stack(list(named.values()), axis=1)
    milliseconds = np.rint(truth.time * 1e3).astype(int)
    if form == "csv":
        rows = [f"{t}," + ",".join(f"{v:.9g}" for v in row) for t, row in zip(milliseconds, table, strict=True)]
        path.write_text("\n".join(["Timestamp," + ",".join(named), *rows]) + "\n")
    else:
        path.write_bytes(
            crazyflie_log(
                [(name, "d") for name in named],
                [(int(t) * 1000, tuple(row)) for t, row in zip(milliseconds, table, strict=True)],
            )
        )
    return read_log(path)


def _says_missing(log: Log) -> bool:
    return any("neither rotor speeds nor commands" in finding.text for finding in judge(log).findings)


FORMS = pytest.mark.parametrize("form", ["csv", "card"])


@FORMS
@pytest.mark.parametrize(
    ("names", "quantity"),
    [("motor.m{}req", "rotor_command"), ("bldc.rpm{}", "rotor_speed"), ("esc.rotor{}Speed", "rotor_speed"),
     ("powerDist.t{}", "rotor_command")],
)  # fmt: skip
def test_variables_that_may_be_rotors_are_candidates(
    truth: Truth, tmp_path: Path, names: str, quantity: str, form: str
) -> None:
    scale = 1.0 if quantity == "rotor_speed" else 1.0 / truth.rotor_speed.max()
    log = _log(truth, {names.format(n + 1): truth.rotor_speed[:, n] * scale for n in range(4)}, tmp_path / "log", form)
    (unused,) = log.provenance.candidates(["rotor_speed", "rotor_command"])
    assert unused.fields == tuple(names.format(n + 1) for n in range(4))
    assert (unused.quantity, unused.count) == (quantity, len(truth.time))
    assert not _says_missing(log)


@FORMS
def test_a_variable_that_is_not_logged_is_named(truth: Truth, tmp_path: Path, form: str) -> None:
    log = _log(truth, {f"motor.m{n}": 40.0 * truth.rotor_speed[:, n - 1] for n in (1, 2, 4)}, tmp_path / "log", form)
    (unused,) = log.provenance.candidates(["rotor_command"])
    assert unused.reason == "motor.m3, which belongs to them, is not logged"
    assert not _says_missing(log)


@FORMS
def test_variables_of_which_others_are_used_are_listed(truth: Truth, tmp_path: Path, form: str) -> None:
    columns = {f"kalman.state{axis}": truth.position[:, n] for n, axis in enumerate("XYZ")}
    columns |= {f"stateEstimateZ.a{axis}": 1e3 * truth.specific_force[:, n] for n, axis in enumerate("xyz")}
    log = _log(truth, columns, tmp_path / "log", form)
    by_quantity = {unused.quantity: unused for unused in log.provenance.unused}
    assert by_quantity["position"].reason == "position is taken from stateEstimate.x/y/z"
    assert "gravity" in by_quantity["specific_force"].reason


@FORMS
def test_variables_that_stand_still_never_win_over_those_that_move(truth: Truth, tmp_path: Path, form: str) -> None:
    columns = {f"motor.m{n + 1}": np.zeros(len(truth.time)) for n in range(4)}
    columns |= {f"pwm.m{n + 1}_pwm": 40.0 * truth.rotor_speed[:, n] for n in range(4)}
    log = _log(truth, columns, tmp_path / "log", form)
    stream = log.stream("rotor_command")
    assert stream is not None
    assert stream.source.startswith("pwm.")
    assert any("stands still" in unused.reason for unused in log.provenance.unused)


@FORMS
def test_a_log_without_any_rotor_still_lacks_them(truth: Truth, tmp_path: Path, form: str) -> None:
    log = _log(truth, {"pm.vbat": 4.0 - 0.01 * truth.time, "radio.rssi": truth.time}, tmp_path / "log", form)
    assert not log.provenance.unused
    assert _says_missing(log)


def test_candidates_of_each_file_are_those_of_the_flight(truth: Truth, tmp_path: Path) -> None:
    _log(truth, {f"bldc.rpm{n + 1}": truth.rotor_speed[:, n] for n in range(4)}, tmp_path / "a.csv", "csv")
    _log(
        truth,
        {f"acc.{axis}": truth.specific_force[:, n] / 9.81 for n, axis in enumerate("xyz")},
        tmp_path / "b.csv",
        "csv",
    )
    log = read_one_flight([tmp_path / "a.csv", tmp_path / "b.csv"])
    assert log.provenance.candidates(["rotor_speed"])
    assert not _says_missing(log)
