"""Closed-loop poles: the flight that was lost, the files that `alula add` can write, and an independent check."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from dynamics.model import build_model
from dynamics.rate_loop import RateController, autopilot_gains, rate_controller
from dynamics.trim import find_trim
from dynamics.vehicle import EffectUse, Vehicle
from dynamics.vehicle_file import with_settings
from fixtures.closed_loop_cases import NOMINAL, VEHICLES, Meeting, bundled, files, oscillation
from runtime.control.closed_loop import (
    LinearController,
    Oscillation,
    Timing,
    closed_loop_poles,
    hover_model,
    linear_controller,
    worst_damped,
)
from runtime.control.controller import ControllerOptions
from runtime.control.rti.solver import SOLVED, RtiSolver

WELL_DAMPED, DAMPED = 0.25, 0.03  # as the file states it; with everything off at once
HARDEST = (  # slowest as the least damped of `benchmarks/results/closed_loop.md`
    Meeting(lag=1.4, inertia=1.25, gain=0.7, latency=0.005),
    Meeting(lag=1.4, inertia=0.8, gain=1.4, latency=0.005),
    Meeting(lag=0.7, inertia=0.8, gain=1.4, latency=0.005),
)


def lagging(seconds: float) -> Vehicle:
    """px4_sih with a motor lag, s."""
    return bundled("px4_sih").with_effect_replaced(EffectUse("motor_lag", {"time_constant": seconds}))


def on_slow_motors(setpoint: str) -> Oscillation:
    """The corrected file on PX4's quadrotor with SIH_T_TAU = 0.09, PX4's gains unchanged, gains not read."""
    flown, owner = lagging(0.09271), bundled("px4_sih")
    options = msgspec.structs.replace(ControllerOptions.for_vehicle(flown), setpoint=setpoint)  # type: ignore[arg-type]
    linear = linear_controller(hover_model(build_model(flown)), options, find_trim(build_model(flown)).vehicle)
    inner = rate_controller(owner, autopilot_gains(owner))
    return worst_damped(closed_loop_poles(linear, hover_model(build_model(lagging(0.09))), owner, inner, Timing()))


def test_it_predicts_the_oscillation_of_the_flight_that_was_lost() -> None:
    """Real PX4 oscillated at 2 Hz, more and more; along the acceleration that inputs command nothing does."""
    lost = on_slow_motors("predicted")
    assert not lost.is_stable
    assert lost.frequency == pytest.approx(2.0, abs=0.1)
    assert on_slow_motors("commanded").damping > WELL_DAMPED


def test_the_bare_rate_loop_has_the_poles_of_its_characteristic_polynomial() -> None:
    """A controller that requests nothing leaves motors, proportional gain and damping: a loop of second order."""
    vehicle = msgspec.structs.replace(lagging(0.05), effects=(EffectUse("motor_lag", {"time_constant": 0.2}),))
    hover = hover_model(build_model(vehicle))
    options = ControllerOptions.for_vehicle(vehicle)
    states, inputs = hover.state.size - 1, hover.rotor_speed.size
    idle = LinearController(options, np.zeros((inputs, states)), np.zeros((4, states)), hover.over(0.001))
    gain = 0.15
    inner = RateController((gain, gain, 0.0), (0.0,) * 3, (0.0,) * 3, 400.0, 400.0, 400.0)
    slowest = worst_damped(closed_loop_poles(idle, hover, vehicle, inner, Timing()))
    dead_time = 0.006 + 0.001 + np.sqrt(2) / (2 * np.pi * 400.0)
    s = np.roots([0.2, 1.0, gain * 113.14])[0]
    for _ in range(50):  # 0.2 s^2 + s + K exp(-s dead_time) = 0
        s = s - (0.2 * s**2 + s + gain * 113.14 * np.exp(-s * dead_time)) / (
            0.4 * s + 1 - dead_time * gain * 113.14 * np.exp(-s * dead_time)
        )
    assert slowest.frequency == pytest.approx(abs(s.imag) / (2 * np.pi), rel=0.02)
    assert slowest.damping == pytest.approx(-s.real / abs(s), abs=0.02)


CASES = [(name, added) for name in VEHICLES for added in files(bundled(name))]


@pytest.mark.parametrize(("name", "added"), CASES, ids=[f"{name}: {added}" for name, added in CASES])
def test_what_add_can_write_is_damped(name: str, added: str) -> None:
    versions = files(bundled(name))[added]
    owner, written = versions[0], versions[-1]
    as_stated = oscillation(written, written, owner).damping
    assert as_stated > WELL_DAMPED
    assert as_stated > min(oscillation(owner, written, owner).damping, WELL_DAMPED)
    assert oscillation(written, written, owner, gains_read=False).damping > DAMPED
    damped = 0.0 if added == "slung load" else DAMPED  # a load swings by itself with a damping of 0.01
    assert min(oscillation(written, written, owner, meeting).damping for meeting in HARDEST) > damped


def test_every_version_of_a_chain_is_damped_with_the_gains_of_the_first() -> None:
    versions = files(bundled("px4_sih"))["slower motors, then inertia x 1.3, then thrust x 0.85"]
    assert [version.autopilot is None for version in versions] == [True, False, False, False]
    assert {version.autopilot for version in versions[1:]} == {autopilot_gains(versions[0])}
    for version in versions:
        assert oscillation(version, version, versions[0], NOMINAL, gains_read=False).damping > WELL_DAMPED


@pytest.mark.parametrize("growth", [1.0, 1.1], ids=["equal", "growing"])
def test_the_linear_gain_is_that_of_the_solver_in_hover(growth: float) -> None:
    """Whatever the intervals, the quadratic program without active bounds is this regulator."""
    vehicle = with_settings(bundled("arpl_250g"), ["controller.nodes=10", f"controller.growth={growth}"])
    options, model = ControllerOptions.for_vehicle(vehicle), build_model(vehicle)
    linear = linear_controller(hover_model(model), options, vehicle)
    solver = RtiSolver(model, options.problem)
    state = np.array([0.0, 0.0, 1.0, *[0.0] * 3, 1.0, *[0.0] * 6])
    solver.reset(state)
    solver.state_reference[:], solver.input_reference[:] = state, vehicle.hover_speed
    assert solver.prepare(state) == 0
    before, moved = solver.inputs[0].copy(), state.copy()
    change = np.array([0.004, -0.003, 0.005, 0.01, -0.01, 0.01])
    moved[:6] += change
    assert solver.feedback(moved) == SOLVED
    np.testing.assert_allclose(solver.inputs[0] - before, -linear.gain[:, :6] @ change, rtol=1e-3)
