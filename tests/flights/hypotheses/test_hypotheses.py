"""Columns that are other than declared are named by how physics closes, on real flights and another simulator's."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

from dynamics import quaternion
from dynamics.vehicle import GRAVITY
from fixtures.wrong_columns import MUTATIONS, Streams, attitude, in_bursts, rotation, turned, with_values
from flights import read_log
from flights.hypotheses import explain
from flights.hypotheses.hypothesis import after, is_better
from flights.log import Stream

DATA = Path("tests/data")
RIGHT = [
    DATA / "nanobench" / "B3_figure8_fast_rep1.csv.gz",
    DATA / "px4_sih_flights" / "drag2_4_lemniscate.ulg.gz",
    DATA / "rotorpy_100hz" / "flight_2.csv.gz",
]
BRISK = pytest.mark.parametrize("log", RIGHT, ids=lambda path: path.name)


@cache
def streams_of(log: Path) -> dict[str, Stream]:
    first: dict[str, Stream] = {}
    for stream in read_log(log).streams:
        first.setdefault(stream.name, stream)
    return first


@BRISK
def test_a_right_log_is_what_it_declares(log: Path) -> None:
    assert explain(list(streams_of(log).values())) == ()


@BRISK
@pytest.mark.parametrize("name", MUTATIONS)
def test_a_wrong_declaration_is_named_and_its_repair_leaves_nothing_to_repair(log: Path, name: str) -> None:
    change, causes = MUTATIONS[name]
    right = streams_of(log)
    if name == "velocity in cm/s" and "velocity" not in right:
        pytest.skip("the log has no velocity")
    streams = change(dict(right))
    hypotheses = explain(list(streams.values()))
    assert causes & {hypothesis.name for hypothesis in hypotheses}, [str(hypothesis) for hypothesis in hypotheses]
    repaired: dict[str, Stream] = streams
    for hypothesis in hypotheses:
        repaired = after(repaired, hypothesis)
    assert explain(list(repaired.values())) == ()


@BRISK
def test_evidence_compares_with_the_log_as_it_is(log: Path) -> None:
    streams = MUTATIONS["accelerometer FRD"][0](dict(streams_of(log)))
    (hypothesis,) = explain(list(streams.values()))
    then, as_declared = (float(part.split(" ")[0]) for part in hypothesis.evidence.split("; ")[1].split("then, "))
    assert as_declared < then - 0.1


@pytest.mark.parametrize("degrees", [20.0, 45.0, 120.0])
@pytest.mark.parametrize("axis", [[0.0, 0.0, 1.0], [0.6, -0.3, 0.2]])
def test_the_turn_of_an_imu_is_given_to_half_a_degree(axis: list[float], degrees: float) -> None:
    streams = turned(("rate", "specific_force"), rotation(axis, degrees).T)(dict(streams_of(RIGHT[2])))
    (hypothesis,) = explain(list(streams.values()))
    assert "the IMU is turned by" in hypothesis.text
    degrees_named = float(hypothesis.text.split("turned by ")[1].split(" ")[0])
    assert degrees_named == pytest.approx(degrees, abs=0.5)


def test_two_wrong_things_are_both_named() -> None:
    streams = dict(streams_of(RIGHT[0]))
    for name in ("position in mm", "x, y, z, w", "rates in deg/s"):
        streams = MUTATIONS[name][0](streams)
    assert {h.name for h in explain(list(streams.values()))} >= {
        "position_unit",
        "quaternion_order",
        "rates_in_degrees",
    }


def test_a_factor_that_is_no_unit_is_called_a_factor() -> None:
    streams = dict(streams_of(RIGHT[2]))
    streams["rate"] = with_values(streams["rate"], 0.01 * streams["rate"].values)
    (hypothesis,) = explain(list(streams.values()))
    assert "a factor that is no unit" in hypothesis.text
    assert hypothesis.repairs[0].scale == pytest.approx(100.0, rel=0.02)


def dragged_flight(acceleration: float, drag: float) -> Streams:
    """A flight of 20 s with one heading, whose tilt overcomes a drag that its accelerometer reads.

    acceleration: m/s^2 rms over the three axes. drag: linear, 1/s.
    """
    time = np.arange(0.0, 20.0, 0.01)
    turning = 2 * np.pi * np.array([0.2, 0.15, 0.1])
    peak = acceleration * np.sqrt(2) * np.array([1.3, 1.0, 0.557])
    phase = turning * time[:, None] + np.array([0.0, 1.0, 2.0])
    velocity = -peak / turning * np.cos(phase)
    force = peak * np.sin(phase) + [0.0, 0.0, GRAVITY]
    thrust = force + drag * velocity
    axis = np.cross([0.0, 0.0, 1.0], thrust)
    tilt = np.arctan2(np.linalg.norm(axis, axis=1), thrust[:, 2])[:, None]
    pose = quaternion.exponential(tilt * axis / np.maximum(np.linalg.norm(axis, axis=1, keepdims=True), 1e-12))
    noise = np.random.default_rng(7).normal(size=(2, len(time), 3))
    values = {
        "attitude": pose,
        "velocity": velocity + 2e-3 * noise[0],
        "position": -peak / turning**2 * np.sin(phase),
        "specific_force": quaternion.rotate_inverse(pose, force) + 0.1 * noise[1],
    }
    return {name: Stream(name, time, columns, "") for name, columns in values.items()}


@pytest.mark.parametrize("drag", [0.0, 0.4, 1.2])
@pytest.mark.parametrize("acceleration", [0.12, 0.18, 0.22, 0.24, 0.26, 0.28, 0.29, 0.31, 0.34, 0.4, 0.5])
def test_a_gentle_flight_is_what_it_declares_however_large_its_drag(acceleration: float, drag: float) -> None:
    assert explain(list(dragged_flight(acceleration, drag).values())) == ()


@pytest.mark.parametrize("acceleration", [0.12, 0.18, 0.22, 0.24, 0.26, 0.28, 0.29, 0.31, 0.34, 0.4, 0.5])
def test_motion_that_tells_one_reading_tells_all_of_them(acceleration: float) -> None:
    """The repair of a flight with world to body attitudes is that or, where it is too gentle, none, but no other."""
    streams = attitude(quaternion.conjugate)(dragged_flight(acceleration, 0.6))
    repairing = [one.name for one in explain(list(streams.values())) if one.repairs]
    assert repairing == (["attitude_conjugate"] if acceleration > 0.3 else [])


def test_hover_tells_nothing_and_says_nothing() -> None:
    time = np.arange(0.0, 20.0, 0.01)
    noise = np.random.default_rng(5).normal(size=(len(time), 10))
    level = np.column_stack([np.ones(len(time)), 1e-3 * noise[:, :3]])
    still = [
        Stream("attitude", time, level / np.linalg.norm(level, axis=1, keepdims=True), ""),
        Stream("position", time, 1e-3 * noise[:, 3:6], ""),
        Stream("rate", time, 1e-2 * noise[:, 6:9], ""),
        Stream("specific_force", time, np.column_stack([0.1 * noise[:, :2], 9.81 + 0.1 * noise[:, 2]]), ""),
    ]
    assert explain(still) == ()


def test_lost_samples_are_no_bursts() -> None:
    streams = dict(streams_of(RIGHT[0]))
    rows = np.random.default_rng(1).random(len(streams["attitude"].time)) > 0.2
    lost = {n: with_values(s, s.values[rows], s.time[rows]) for n, s in streams.items() if len(s.time) == len(rows)}
    assert explain(list({**streams, **lost}.values())) == ()


def test_even_stamps_are_the_samples_own_but_for_a_constant() -> None:
    right = streams_of(RIGHT[0])
    streams = in_bursts(dict(right))
    for hypothesis in explain(list(streams.values())):
        streams = after(streams, hypothesis)
    off = streams["attitude"].time - right["attitude"].time
    period = right["attitude"].period
    assert np.ptp(off) < 0.5 * period


@pytest.mark.parametrize("share", [0.55, 0.8, 1.1])
@pytest.mark.parametrize("seed", range(12))
def test_an_estimators_error_of_velocity_is_no_clock_and_no_turn(seed: int, share: float) -> None:
    """It takes as much from the velocity as the motion gives; of many shifts and turns one fits a little better."""
    streams, random = dragged_flight(0.5, 0.4), np.random.default_rng(seed)
    true = streams["velocity"].values
    error = lfilter([1.0], [1.0, -np.exp(-0.01 / 1.5)], random.normal(size=true.shape), axis=0)
    error = lfilter([1.0], [1.0, -np.exp(-0.01 / 0.3)], error, axis=0)
    size = random.uniform(0.75, 1.25) * share * np.linalg.norm(true.std(axis=0)) / np.linalg.norm(error.std(axis=0))
    streams = {**streams, "velocity": with_values(streams["velocity"], true + size * error)}
    assert explain(list(streams.values())) == ()


@pytest.mark.parametrize(
    ("share", "declared", "clear"),
    [
        (0.92, 0.85, False),
        (0.52, 0.5, False),
        (0.05, 0.0, False),
        (0.99, 0.85, True),
        (0.999, 0.97, True),
        (0.8, 0.5, True),
    ],
)
def test_a_clearly_better_share_is_one_that_leaves_much_less_open(share: float, declared: float, clear: bool) -> None:
    """An estimator's errors made left-handed axes of right ones for 0.92 against 0.85, and for 0.52 against 0.50."""
    assert is_better(share, declared) == clear
