"""Units and frames that contradict the motion are refused on real flights; what is right never is."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from dynamics import frames, quaternion
from dynamics.errors import DataError, RequestError
from dynamics.vehicle import GRAVITY
from flights import Flight, plausibility, read_log
from flights.hypotheses import explain
from flights.log import Stream
from flights.mapping import MappedStream

DATA = Path("tests/data")
NANOBENCH = sorted((DATA / "nanobench").glob("*.gz"))
REAL = [*NANOBENCH, *sorted((DATA / "px4_sih_flights").glob("*.gz")), DATA / "crazyflie" / "log20.gz"]
Columns = dict[str, np.ndarray]


def quantity(_: Flight, name: str, values: np.ndarray) -> Columns:
    return {f"{name}_{axis}": values[:, i] for i, axis in enumerate("xyz")}


def scaled(name: str, factor: float) -> Callable[[Flight], Columns]:
    return lambda flight: quantity(flight, name, flight[name] * factor)


def ordered(name: str, order: list[int]) -> Callable[[Flight], Columns]:
    return lambda flight: quantity(flight, name, flight[name][:, order])


def in_the_world(flight: Flight) -> Columns:
    return quantity(flight, "specific_force", quaternion.rotate(flight["attitude"], flight["specific_force"]))


def late(name: str, seconds: float) -> Callable[[Flight], Columns]:
    def moved(flight: Flight) -> Columns:
        rows = round(seconds * flight.rate)
        return {c: np.roll(v, rows) for c, v in flight.columns.items() if c.startswith(f"{name}_")}

    return moved


def without_gravity(flight: Flight) -> Columns:
    up = quaternion.rotate_inverse(flight["attitude"], np.array([0.0, 0.0, 9.81]))
    return quantity(flight, "specific_force", flight["specific_force"] - up)


@pytest.mark.parametrize("log", REAL, ids=lambda path: path.name)
def test_real_flights_contradict_nothing(log: Path) -> None:
    assert plausibility.check(read_log(log).streams) == ()


@pytest.mark.parametrize("log", NANOBENCH, ids=lambda path: path.name)
@pytest.mark.parametrize(
    ("change", "message"),
    [
        (in_the_world, "it is in world axes"),
        (without_gravity, "gravity's reaction was removed"),
        (scaled("specific_force", 1 / 9.81), "force is in g "),
        (scaled("specific_force", 1000 / 9.81), "force is in mg "),
        (scaled("position", 1000.0), "position is in mm "),
        (scaled("velocity", 1000.0), "velocity is in mm/s "),
        (scaled("velocity", 100.0), "velocity is in cm/s "),
        (scaled("rate", 180 / np.pi), "deg/s"),
        (scaled("rate", 0.5), r"0\.[45]. times those by which the attitude turns"),
        (scaled("specific_force", 2.0), "in another unit"),
        (late("velocity", 0.2), r"the velocity is .*0\.20 s late"),
        (late("rate", -0.3), r"the rate is on another clock than the attitude: 0\.30 s early"),
        (late("rate", -0.1), r"the rate is on another clock than the attitude: 0\.10 s early"),
        (
            lambda f: quantity(f, "specific_force", f["specific_force"] * [-1.0, 1.0, 1.0]),
            "accelerometer has left-handed axes .* -x, y, z",
        ),
        (
            ordered("rate", [1, 0, 2]),
            r"the gyro (has left-handed axes|is turned by 180.0 degrees about \(0.71, 0.71, 0.00\))",
        ),
        (ordered("velocity", [1, 0, 2]), "the velocity has left-handed axes"),
        (lambda f: quantity(f, "rate", f["rate"] * [1.0, 0.0, 1.0]), "about y stands still"),
        (lambda f: quantity(f, "rate", frames.flu_from_frd(f["rate"])), "the gyro is in FRD axes"),
        (
            lambda f: quantity(f, "specific_force", frames.flu_from_frd(f["specific_force"])),
            "the accelerometer is in FRD axes",
        ),
    ],
    ids=[
        "world axes",
        "no gravity",
        "g",
        "mg",
        "mm",
        "mm/s",
        "cm/s",
        "deg/s",
        "half the rate",
        "twice g",
        "late velocity",
        "early gyro",
        "gyro a little early",
        "turned accelerometer",
        "rate axes",
        "velocity axes",
        "dead gyro",
        "FRD",
        "FRD force",
    ],
)
def test_wrong_units_and_frames_of_a_real_flight_are_refused(
    log: Path, change: Callable[[Flight], Columns], message: str, tmp_path: Path
) -> None:
    real = Flight.read(log)
    wrong = Flight(real.time, {**real.columns, **change(real)}, real.provenance)
    with pytest.raises(DataError, match=message):
        read_log(wrong.to_csv(tmp_path / "wrong.csv"))


def climbing(error: float) -> list[Stream]:
    """60 s up and down a steep line in z and y; the velocity along y errs by `error` m/s, slowly, as an estimator's."""
    time = np.arange(0.0, 60.0, 0.02)
    velocity = np.outer(np.sin(0.8 * time), [0.0, 0.3, 1.0])
    position = np.cumsum(velocity, axis=0) * 0.02
    estimated = velocity + error * np.outer(np.cos(0.8 * time), [0.0, 1.0, 0.0])
    return [Stream("position", time, position, ""), Stream("velocity", time, estimated, "")]


def test_an_estimators_error_is_no_exchange_of_axes() -> None:
    """Along y it moves by less than the estimate errs, so that y resembles z, along which it moves."""
    assert plausibility.check(climbing(0.5)) == ()


@pytest.mark.parametrize(
    ("speed", "error", "sign", "expected"),
    [(0.1, 0.2, 1.0, []), (0.2, 0.0, -1.0, ["velocity_frame"]), (0.6, 0.2, -1.0, ["velocity_frame"])],
    ids=["slow and right", "slow without errors", "fast"],
)
def test_errors_of_an_estimator_are_no_opposite_sign(
    speed: float, error: float, sign: float, expected: list[str]
) -> None:
    """Position and velocity along z err against each other; without errors a wrong sign shows in slow motion."""
    time = np.arange(0.0, 20.0, 0.02)
    climb, errs = (np.sqrt(2) * size * np.sin(rate * time) for size, rate in ((speed, 0.9), (error, 0.5)))
    across = np.column_stack([np.cos(0.6 * time), np.sin(0.7 * time)])
    position = np.cumsum(np.column_stack([across, climb + errs]), axis=0) * 0.02
    velocity = np.column_stack([across, sign * climb - errs])
    streams = [Stream("position", time, position, ""), Stream("velocity", time, velocity, "")]
    assert [finding.name for finding in plausibility.check(streams)] == expected


@pytest.mark.parametrize(("scale", "expected"), [(1.0, []), (0.3048, ["position_unit"])])
def test_what_an_estimator_errs_in_slow_motion_is_no_unit(scale: float, expected: list[str]) -> None:
    """The velocity errs by more than the vehicle moves: it is 1.7 times the position's change, and agrees with half of
    it. A position in another unit changes by less than that explains."""
    time = np.arange(0.0, 20.0, 0.02)
    moves = 0.24 * np.column_stack([np.cos(0.9 * time), np.sin(0.7 * time), np.cos(1.3 * time)])
    error = 0.33 * np.column_stack([np.sin(0.5 * time), np.cos(0.4 * time), np.sin(0.6 * time)])
    position = np.cumsum(moves, axis=0) * 0.02
    streams = [Stream("position", time, scale * position, ""), Stream("velocity", time, moves + error, "")]
    assert [finding.name for finding in plausibility.check(streams)] == expected


def tumbling(fall: float) -> list[Stream]:
    """10 s in which a vehicle rolls over once a second and falls by `fall` m/s^2, air drag and thrust as they come."""
    time = np.arange(0.0, 10.0, 0.005)
    roll = 2 * np.pi * time + np.sin(2 * time)
    attitude = quaternion.exponential(roll[:, None] * np.array([1.0, 0.0, 0.0]))
    velocity = np.outer(-fall * time + 0.5 * np.sin(time), [0.0, 0.0, 1.0])
    acceleration = np.gradient(velocity, time, axis=0)
    force = quaternion.rotate_inverse(attitude, acceleration + np.array([0.0, 0.0, GRAVITY]))
    rate = np.outer(np.gradient(roll, time), [1.0, 0.0, 0.0])
    values = {"velocity": velocity, "attitude": attitude, "specific_force": force, "rate": rate}
    return [Stream(name, time, value, "") for name, value in values.items()]


@pytest.mark.parametrize("fall", [5.0, 8.0])
def test_a_fall_is_no_wrong_unit(fall: float) -> None:
    assert plausibility.check(tumbling(fall)) == ()


def test_a_wrong_unit_is_seen_in_a_fall() -> None:
    streams = [
        dataclasses.replace(s, values=s.values * 5.0) if s.name == "specific_force" else s for s in tumbling(5.0)
    ]
    assert [finding.name for finding in plausibility.check(streams)] == ["force_unit"]


@pytest.mark.parametrize("world", ["ENU", "NED"])
@pytest.mark.parametrize("body", ["FLU", "FRD"])
def test_a_mapped_attitude_has_the_axes_that_the_mapping_names(world: str, body: str, tmp_path: Path) -> None:
    real = Flight.read(NANOBENCH[0])
    attitude, rate, velocity = real["attitude"], real["rate"], real["velocity"]
    if world == "NED":
        attitude, velocity = frames.attitude_to_enu(attitude), frames.enu_from_ned(velocity)
    if body == "FRD":
        attitude, rate = frames.attitude_of_flu(attitude), frames.flu_from_frd(rate)
    table = np.column_stack([real.time, attitude, rate, velocity])
    np.savetxt(tmp_path / "log.txt", table, delimiter=",", header="s,w,x,y,z,p,q,r,u,v,n", comments="", fmt="%.9g")
    (tmp_path / "axes.toml").write_text(
        'name = "axes"\n[time]\ncolumn = "s"\n'
        f'[frames]\nworld = "{world}"\nbody = "{body}"\n'
        '[[streams]]\nquantity = "attitude"\ncolumns = ["w", "x", "y", "z"]\norder = "wxyz"\n'
        '[[streams]]\nquantity = "rate"\ncolumns = ["p", "q", "r"]\n'
        '[[streams]]\nquantity = "velocity"\ncolumns = ["u", "v", "n"]\n'
    )
    log = read_log(tmp_path / "log.txt", mapping=tmp_path / "axes.toml")
    stream = log.stream("attitude")
    assert stream is not None
    np.testing.assert_allclose(np.abs(np.sum(stream.values * real["attitude"], axis=1)), 1.0, atol=1e-6)


@pytest.mark.parametrize(
    ("name", "columns", "frame", "message"),
    [
        ("thrust_setpoint", ("a",), "NED", "no axes of its own"),
        ("velocity", ("a", "b", "c"), "FRD", "ENU or NED fits"),
        ("rate", ("a", "b", "c"), "NED", "FLU or FRD fits"),
    ],
)
def test_a_frame_that_does_not_fit_the_quantity_is_refused(
    name: str, columns: tuple[str, ...], frame: str, message: str
) -> None:
    with pytest.raises(RequestError, match=message):
        MappedStream(name, columns, frame=frame)  # type: ignore[arg-type]


@pytest.mark.parametrize("log", NANOBENCH, ids=lambda path: path.name)
@pytest.mark.parametrize("without", [(), ("rate",), ("specific_force",)], ids=lambda names: "-".join(names) or "all")
def test_a_quaternion_with_w_last_is_named_as_such(log: Path, without: tuple[str, ...]) -> None:
    """It was called a specific force in g, or axes FRD."""
    streams = [stream for stream in read_log(log).streams if stream.name not in without]
    moved = [
        dataclasses.replace(stream, values=stream.values[:, [1, 2, 3, 0]]) if stream.name == "attitude" else stream
        for stream in streams
    ]
    assert [hypothesis.name for hypothesis in explain(moved)] == ["quaternion_order"]
    assert "quaternion is x, y, z, w" in explain(moved)[0].text
    assert explain(streams) == ()
