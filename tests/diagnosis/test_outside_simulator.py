"""The outside simulator shares no line with our dynamics: forces must agree; its errors are those of real sensors."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import alula
from dynamics.effects import CATALOGUE
from dynamics.model import build_model
from fixtures.outside_cases import SIZES, Campaign, file_of, flown, sized, use_of, write_campaign
from fixtures.outside_effects import CATALOGUED, OF_SENSORS, wrench_of
from fixtures.outside_sensors import PX4_TILT, Recorder, drifting
from fixtures.outside_simulator import Airframe, G, merged
from flights.pose_source import source_of

NOT_STATIC = ("slung_load", "battery_sag", "motor_lag", "wind", "gust", "lost_propeller")
STATIC = [n for n in CATALOGUED if n not in NOT_STATIC]
QUIET = Campaign({}, {}, Recorder(noise=0.0), lag_declared=False, fast=False, flights=1, seed=3, duration=3.0)


def fleet_of(frame: Airframe, hidden: dict[str, dict[str, float]]) -> SimpleNamespace:
    """One vehicle at rest air."""
    columns = merged([hidden])
    fleet = SimpleNamespace(
        hidden=columns, spin=frame.spin[None], motors=len(frame.spin), air=None, flicker=np.zeros((1, 1, 1)),
        lift=frame.thrust_constant, twist=frame.torque_constant, hover=frame.hover_speed, plant_mass=frame.mass,
    )  # fmt: skip
    fleet.value = lambda effect, name, neutral: columns.get(effect, {}).get(name, np.full((1, 1), neutral))
    fleet.arms = frame.rotors[None] - [[fleet.value("centre_of_mass", axis, 0.0)[0, 0] for axis in "xyz"]]
    return fleet


@pytest.mark.parametrize("name", STATIC)
def test_it_computes_the_same_accelerations_as_our_model(name):
    random = np.random.default_rng(11)
    frame = QUIET.frame
    values = sized(name, frame, random)
    fleet = fleet_of(frame, {name: values})
    plain = build_model(file_of(frame, {}, lag=False))
    model = build_model(file_of(frame, {name: values}, lag=False))
    mass = frame.mass * values["ratio"] if name == "mass" else frame.mass
    inertia = frame.inertia * ([values[f"ratio_{a}"] for a in "xyz"] if name == "inertia" else 1.0)
    shows = 0.0
    for _ in range(4):
        velocity, rate = 2 * random.standard_normal(3), 2 * random.standard_normal(3)
        turn = Rotation.from_rotvec(0.4 * random.standard_normal(3))
        speed, spin_up = frame.hover_speed * random.uniform(0.8, 1.2, len(frame.spin)), np.zeros(len(frame.spin))
        state = SimpleNamespace(
            velocity=velocity[None], rate=rate[None], rotation=turn.as_matrix()[None], speed=speed[None],
            spin_up=spin_up[None], position=np.array([[0.3, -0.2, 0.2]]), time=0.0, memory={},
        )  # fmt: skip
        force, moment = (part[0] for part in wrench_of(fleet, state, 0))
        angular = (moment - np.cross(rate, inertia * rate)) / inertia
        attitude = turn.as_quat()[[3, 0, 1, 2]]
        x = np.concatenate([[0.3, -0.2, 0.2], velocity, attitude, rate])
        ours, without = (m.observe(x, speed, m.parameter_values, [0.0, 1.0])[:2] for m in (model, plain))
        np.testing.assert_allclose(np.array(ours[0]).ravel(), force / mass, rtol=1e-8, atol=1e-8)
        np.testing.assert_allclose(np.array(ours[1]).ravel(), angular, rtol=1e-8, atol=1e-8)
        shows += float(sum(np.linalg.norm(np.array(a - b)) for a, b in zip(ours, without, strict=True)))
    assert shows > 0.01


def test_every_effect_of_the_catalogue_can_be_hidden_or_is_listed():
    elsewhere = {"wall_effect", "imu_lever_arm", "pose_lever_arm"}  # no walls; lever arms come with centre_of_mass
    assert set(CATALOGUE) - {*CATALOGUED, *OF_SENSORS} <= elsewhere
    assert {*CATALOGUED, *OF_SENSORS} <= set(SIZES)
    assert all(use_of(n, sized(n, QUIET.frame, np.random.default_rng(0))).name == n for n in SIZES)


def test_the_accelerometer_feels_what_moves_the_vehicle():
    (truths,) = flown([QUIET])
    truth = truths[0]
    acceleration = np.gradient(truth.velocity, truth.time, axis=0)
    felt = np.einsum("tij,tj->ti", truth.rotation, truth.force) - [0.0, 0.0, G]
    np.testing.assert_allclose(felt[5:-5], acceleration[5:-5], atol=0.02)
    assert np.ptp(truth.position, axis=0).max() > 0.3


def test_a_slung_load_hangs_on_a_line_of_its_length():
    hidden = {"slung_load": {"mass": 0.1 * QUIET.frame.mass, "length": 0.6}}
    (truths,) = flown([replace(QUIET, hidden=hidden)])
    assert np.mean(truths[0].force[:, 2]) == pytest.approx(G, rel=0.1)  # it flies, and carries the load by thrust
    lifted = np.mean(truths[0].speed ** 2) / QUIET.frame.hover_speed**2
    assert lifted == pytest.approx(1.1, rel=0.05)


def test_estimator_errors_have_the_measured_sizes_and_times():
    time = np.arange(0, 4000, 0.1)
    errors = drifting(time, PX4_TILT, 3.0, np.random.default_rng(2))
    np.testing.assert_allclose(errors.std(axis=0), PX4_TILT, rtol=0.15)
    later = [np.mean(errors[:-lag, 0] * errors[lag:, 0]) / np.var(errors[:, 0]) for lag in (3, 30)]
    assert later[0] > 0.96
    assert later[1] == pytest.approx(np.exp(-1), abs=0.1)


@pytest.mark.parametrize("pose", ["motion_capture", "estimator"])
def test_its_logs_are_read_with_all_that_they_hold(pose, tmp_path):
    campaign = replace(QUIET, recorder=Recorder(250.0, commands=True, pose=pose), lag_declared=True)
    (truths,) = flown([campaign])
    write_campaign(campaign, truths, tmp_path)
    (log,) = [path for path in tmp_path.iterdir() if path.suffix != ".toml"]
    flight = alula.read_flight(log)
    assert flight.duration == pytest.approx(3.0, abs=0.1)
    assert (source_of(flight.metadata) == "estimator") == (pose == "estimator")
    at = np.searchsorted(truths[0].time, 2.0)
    row = np.searchsorted(flight.time, 2.0)
    where = [flight[f"position_{axis}"][row] for axis in "xyz"]
    np.testing.assert_allclose(where, truths[0].position[at], atol=0.01 if pose == "motion_capture" else 1.0)
    feels = [np.mean(flight[f"specific_force_{axis}"]) for axis in "xyz"]
    np.testing.assert_allclose(feels, truths[0].force[truths[0].time > 0].mean(axis=0), atol=0.3)
    rates = [
        np.corrcoef(flight[f"rate_{a}"], np.interp(flight.time, truths[0].time, truths[0].rate[:, i]))[0, 1]
        for i, a in enumerate("xyz")
    ]
    assert min(rates[:2]) > 0.8
