"""In flight the model follows: the C filter is the textbook's, disturbance and parameters are true, errors bounded."""

from collections.abc import Sequence
from itertools import pairwise

import msgspec
import numpy as np
import pytest

from dynamics.effects import CATALOGUE
from dynamics.errors import RequestError
from dynamics.integrators import rk4
from dynamics.model import ENVIRONMENT_DEFAULT, build_model
from dynamics.references import named_reference
from dynamics.state import RATE, VELOCITY
from dynamics.vehicle import EffectUse, Vehicle
from dynamics.vehicle_file import read_vehicle
from runtime.control.adaptation import Adaptation
from runtime.control.adaptation_settings import AdaptationSettings
from runtime.control.controller import Controller, ControllerOptions
from runtime.control.flight_filter import FlightFilter
from runtime.control.followed_parameters import followed_parameters, with_followed
from runtime.control.rti.problem import Problem, fill_options
from runtime.control.rti.solver import RtiSolver
from simulation.lockstep import FlownReference, fly_reference
from vehicles import FOLDER

HOVER = np.array([0.0, 0.0, 1.0, *[0.0] * 3, 1.0, *[0.0] * 6])
DRAGS = ("wind", "rotor_drag", "parasitic_drag")
ON = AdaptationSettings(mode="on")


def solver_of(vehicle: Vehicle, *follow: str) -> RtiSolver:
    return RtiSolver(build_model(with_followed(vehicle, follow)), Problem())


def reference_update(
    state: np.ndarray, P: np.ndarray, change: np.ndarray, measured: np.ndarray, dt: float
) -> tuple[np.ndarray, np.ndarray]:
    """The Kalman filter of velocity and rate, staying and fading parts."""
    settings, n = AdaptationSettings(), len(state)
    kinds = [settings.linear] * 3 + [settings.angular] * 3
    left = np.exp(-dt / np.array([k.fading_time for k in kinds]))
    F = np.eye(n)
    F[:6, 6:12] = F[:6, 12:18] = dt * np.eye(6)
    F[12:18, 12:18] = np.diag(left)
    Q = np.zeros(n)
    Q[:3] = dt * settings.walk**2
    Q[6:12] = [dt * k.drift**2 for k in kinds]
    Q[12:18] = (1 - left**2) * np.array([k.fading**2 for k in kinds])
    moved = F @ state
    moved[:6] += change
    P = F @ P @ F.T + np.diag(Q)
    H, R = np.eye(6, n), np.diag([k.measurement**2 for k in kinds])
    gain = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
    return moved + gain @ (measured - H @ moved), (np.eye(n) - gain @ H) @ P


def test_the_filter_is_the_textbook_s(arpl_250g: Vehicle) -> None:
    solver, random = solver_of(arpl_250g), np.random.default_rng(4)
    filtered = FlightFilter(solver, AdaptationSettings(gate=1e3, calm=1.0))
    before = HOVER.copy()
    filtered.restart(before, 0.0)
    state, P = solver.filter_state[:18].copy(), solver.filter_covariance.copy()
    model, p = build_model(solver.model.vehicle), solver.model.parameter_values
    speed = np.full(4, arpl_250g.hover_speed)
    for step in range(1, 40):
        measured = before.copy()
        measured[VELOCITY] += random.normal(size=3) * 0.02
        measured[RATE] += random.normal(size=3) * 0.05
        after = rk4(lambda x: np.array(model.derivative(x, speed, p, ENVIRONMENT_DEFAULT, [])).ravel(), before, 0.01)
        change = (after - before)[np.r_[VELOCITY, RATE]]
        state, P = reference_update(state, P, change, np.r_[measured[VELOCITY], measured[RATE]], 0.01)
        filtered.follow(before, speed[None], np.array([0.01]), measured, 0.01 * step)
        before = measured
    np.testing.assert_allclose(solver.filter_state[:18], state, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(solver.filter_covariance, P, rtol=1e-5, atol=1e-10)
    both = np.hstack([np.zeros((6, 6)), np.eye(6), np.eye(6)])
    np.testing.assert_allclose(filtered.disturbance_deviations, np.sqrt(np.diag(both @ P @ both.T)), rtol=1e-5)


def pushed_filter(vehicle: Vehicle, push: Sequence[float], seconds: float) -> tuple[RtiSolver, FlightFilter]:
    """A filter after hover under a constant push, m/s^2, whose estimates are exact; what it estimated is flown."""
    solver, dt = solver_of(vehicle), 0.01
    filtered = FlightFilter(solver, ON)
    speed, before = np.full((1, 4), vehicle.hover_speed), HOVER.copy()
    filtered.restart(before, 0.0)
    for step in range(1, round(seconds / dt) + 1):
        after = before.copy()
        after[VELOCITY] += dt * np.array(push)
        filtered.follow(before, speed, np.array([dt]), after, dt * step)
        before = after
    solver.fly(0.0)
    return solver, filtered


def test_a_disturbance_is_flown_as_far_as_it_is_no_noise(arpl_250g: Vehicle) -> None:
    """The positive-part estimator of James and Stein; a disturbance within its noise is not flown at once."""
    for push in ([0.3, -0.2, 0.1], [2.0, 1.0, 0.0]):
        solver, filtered = pushed_filter(arpl_250g, push, 0.5)
        estimate = filtered.staying[:3] + filtered.fading[:3]
        variance = float(np.mean(filtered.disturbance_deviations[:3] ** 2))
        share = max(0.0, 1.0 - variance / float(estimate @ estimate))
        assert 0.1 < share < 1.0
        flown = solver.disturbance[:3] + solver.disturbance[6:9]
        np.testing.assert_allclose(flown, share * estimate, atol=0.06 * (1 - share) * np.abs(estimate).max())
    solver, filtered = pushed_filter(arpl_250g, [0.02, 0.0, 0.0], 3.0)
    assert np.linalg.norm(filtered.staying[:3] + filtered.fading[:3]) > 0.01
    assert np.linalg.norm(solver.disturbance[:3] + solver.disturbance[6:9]) < 0.005


def test_a_small_disturbance_that_persists_is_flown(arpl_250g: Vehicle) -> None:
    """In steady state nothing is left, however small it is."""
    solver, filtered = pushed_filter(arpl_250g, [0.02, -0.01, 0.01], 100.0)
    estimate = filtered.staying[:3] + filtered.fading[:3]
    np.testing.assert_allclose(estimate, [0.02, -0.01, 0.01], rtol=0.02)
    np.testing.assert_allclose(solver.disturbance[:3] + solver.disturbance[6:9], estimate, rtol=0.02)
    filtered.clear()
    solver.fly(0.0)
    assert not solver.disturbance[:12].any()


def finely_integrated(solver: RtiSolver, speed: np.ndarray, seconds: float) -> np.ndarray:
    """The state after hover under the solver's disturbance, in steps of a tenth of a millisecond."""
    model, x, dt = solver.model, HOVER.copy(), 1e-4
    stays, fades, rates = np.split(solver.disturbance, [6, 12])
    for step in range(round(seconds / dt)):
        extra = stays + np.exp(-np.repeat(rates, 3) * (step + 0.5) * dt) * fades

        def rate(s: np.ndarray, extra: np.ndarray = extra) -> np.ndarray:
            xdot = np.array(model.derivative(s, speed, model.parameter_values, ENVIRONMENT_DEFAULT, [])).ravel()
            xdot[VELOCITY] += extra[:3]
            xdot[RATE] += extra[3:]
            return xdot

        x = rk4(rate, x, dt)
    return x


def test_a_prediction_has_the_disturbance_that_fades(arpl_250g: Vehicle) -> None:
    solver = solver_of(arpl_250g)
    solver.disturbance[:] = [0.8, -0.5, 0.3, 2.0, -1.0, 0.5, 1.0, 0.5, -0.4, -3.0, 2.0, 1.0, 2.0, 5.0]
    speed = np.array([1.01, 0.99, 1.0, 1.0]) * arpl_250g.hover_speed
    long, short = (
        np.abs(solver.propagate(HOVER, speed, seconds) - finely_integrated(solver, speed, seconds)).max()
        for seconds in (0.05, 0.025)
    )
    assert long < 5e-4
    assert short < long / 6  # a step's error is of third order
    solver.reset(HOVER)
    solver.inputs[:] = speed
    solver.state_reference[:], solver.input_reference[:] = HOVER, speed
    assert solver.prepare(HOVER) == 0
    np.testing.assert_allclose(solver.states[1], solver.propagate(HOVER, speed, solver.problem.node), atol=1e-9)


def test_the_linearisation_has_the_disturbance(arpl_250g: Vehicle) -> None:
    """The gradient of the cost by an input is that of the cost of the disturbed prediction."""
    solver = solver_of(arpl_250g)
    solver.disturbance[:] = [0.8, -0.5, 0.3, 2.0, -1.0, 0.5, 1.0, 0.5, -0.4, -3.0, 2.0, 1.0, 2.0, 5.0]
    options = fill_options(solver.problem, solver.model)
    reference = HOVER + np.r_[0.2, 0.1, 0.3, np.zeros(10)]
    hover = np.full((solver.problem.nodes, 4), arpl_250g.hover_speed)
    solver.state_reference[:], solver.input_reference[:] = reference, hover

    def cost(node: int, rotor: int, change: float) -> float:
        solver.reset(HOVER)
        solver.inputs[node, rotor] += change * options.scale
        solver.prepare(HOVER)
        away = solver.states - reference
        weights = np.tile(list(options.Q), (len(away), 1))
        weights[-1] = list(options.P)
        effort = np.array(list(options.R)) * (solver.inputs - hover) ** 2
        return float(0.5 * np.sum(weights * away**2) + 0.5 * np.sum(effort))

    for node, rotor in ((0, 0), (3, 2), (12, 1)):
        slope = (cost(node, rotor, 1e-4) - cost(node, rotor, -1e-4)) / 2e-4
        cost(0, 0, 0.0)
        assert solver.gradient[4 * node + rotor] == pytest.approx(slope, rel=1e-4)


def flown(
    vehicle: Vehicle, name: str, *uses: EffectUse, seconds: float = 8.0, follow: Sequence[str] = (), mode: str = "on"
) -> tuple[FlownReference, Controller]:
    settings = msgspec.convert({"mode": mode, "follow": tuple(follow)}, AdaptationSettings)
    controller = Controller.build(vehicle, ControllerOptions.for_vehicle(vehicle, adaptation=settings))
    reference = named_reference(name, vehicle, duration=seconds)
    return fly_reference(vehicle, reference, effects=uses, seed=5, controller=controller), controller


WIND = (EffectUse("rotor_drag", {"coefficient": 2.2e-5}), EffectUse("wind", {"x": 6.0, "y": 0.0, "z": 0.0}))


def test_a_constant_wind_leaves_no_error(arpl_250g: Vehicle) -> None:
    assert flown(arpl_250g, "Hover", *WIND, mode="off")[0].position_rmse > 0.12
    flight, controller = flown(arpl_250g, "Hover", *WIND)
    assert flight.position_rmse < 0.013
    assert controller.adaptation is not None
    assert controller.adaptation.filter.staying[0] > 1.0  # m/s^2 downwind


@pytest.mark.parametrize("name", ["arpl_250g", "px4_sih", "crazyflie"])
def test_with_an_identified_model_a_push_leaves_no_error(name: str) -> None:
    """Effects of the file that are there, and a wind that is in none of them."""
    vehicle = read_vehicle(FOLDER / f"{name}.toml")
    effects = [EffectUse("mass", {"ratio": 1.08})]
    if all(use.name != "linear_drag" for use in vehicle.effects):  # 0.3 m/s^2 for each m/s
        effects.append(EffectUse("linear_drag", {"coefficient": 0.3 * vehicle.body.mass}))
    identified = vehicle.with_effects(*effects)
    controller = Controller.build(identified, ControllerOptions.for_vehicle(identified, adaptation=ON))
    reference = named_reference("Hover", vehicle, duration=10.0)
    wind = EffectUse("wind", {"x": 3.0, "y": 0.0, "z": 0.0})
    flight = fly_reference(identified, reference, effects=(wind,), seed=5, controller=controller)
    true, setpoint = flight.truth.stream("position"), flight.log.stream("position_setpoint")
    assert true is not None
    assert setpoint is not None
    late = true.time > 5.0
    assert np.linalg.norm((true.values - setpoint.values)[late].mean(axis=0)) < 0.01
    assert controller.adaptation is not None
    assert controller.adaptation.filter.staying[0] > 0.4


def test_in_wind_towards_a_wall_the_box_is_not_left(arpl_250g: Vehicle) -> None:
    """A circle of 0.75 m beside an edge that 6 m/s of wind push it over without the disturbance."""
    wall = 1.0  # m
    limits = msgspec.structs.replace(arpl_250g.limits, box=((-3.0, -3.0, -1.0), (wall, 3.0, 5.0)))
    boxed = msgspec.structs.replace(arpl_250g, limits=limits)
    assert "box" in flown(boxed, "circle:size=0.5", *WIND, mode="off", seconds=6.0)[0].aborted
    flight, _ = flown(boxed, "circle:size=0.5", *WIND, seconds=6.0)
    assert flight.aborted == ""
    position = flight.truth.stream("position")
    assert position is not None
    assert 0.7 < position.values[:, 0].max() < 0.8


def test_a_shadow_estimates_and_flies_as_without(arpl_250g: Vehicle) -> None:
    usual = flown(arpl_250g, "Hover", *WIND, mode="off", seconds=3.0)[0]
    shadowed, controller = flown(arpl_250g, "Hover", *WIND, mode="shadow", seconds=3.0)
    np.testing.assert_array_equal(usual.truth.streams[0].values, shadowed.truth.streams[0].values)
    assert controller.adaptation is not None
    assert controller.adaptation.filter.staying[0] + controller.adaptation.filter.fading[0] > 1.0


@pytest.mark.slow
def test_drag_and_wind_are_named_on_a_fast_path(arpl_250g: Vehicle) -> None:
    flight, controller = flown(arpl_250g, "Lemniscate", *WIND, seconds=14.0, follow=DRAGS)
    assert controller.adaptation is not None
    filtered = controller.adaptation.filter
    named = {p.name: (v, s) for p, v, s in zip(filtered.parameters, filtered.values, filtered.deviations, strict=True)}
    for name, true in (("wind.x", 6.0), ("wind.y", 0.0), ("rotor_drag.coefficient", 2.2e-5)):
        value, deviation = named[name]
        assert abs(value - true) < 3 * deviation, name
    assert named["wind.x"][0] > 4.0
    with_force = flown(arpl_250g, "Lemniscate", *WIND, seconds=14.0)[0]
    assert flight.position_rmse < 0.8 * with_force.position_rmse


def test_in_hover_neither_drag_nor_wind_is_named(arpl_250g: Vehicle) -> None:
    """Only their product shows there: both keep their values, and the disturbance holds the force."""
    flight, controller = flown(arpl_250g, "Hover", *WIND, follow=DRAGS)
    assert controller.adaptation is not None
    filtered = controller.adaptation.filter
    assert not filtered.followed.any()
    np.testing.assert_array_equal(filtered.values, 0.0)
    assert flight.position_rmse < 0.013


def test_with_nothing_hidden_it_flies_no_worse(arpl_250g: Vehicle) -> None:
    usual = flown(arpl_250g, "Lemniscate", mode="off")[0].position_rmse
    assert flown(arpl_250g, "Lemniscate", follow=DRAGS)[0].position_rmse < 1.1 * usual


@pytest.mark.slow
def test_a_drag_of_the_model_is_no_thrust_that_is_missing() -> None:
    """At speed the drag along body z passed for effectiveness, and the disturbance for the difference of both."""
    px4_sih = read_vehicle(FOLDER / "px4_sih.toml")
    usual = flown(px4_sih, "Lemniscate", mode="off", seconds=12.0)[0].position_rmse
    assert flown(px4_sih, "Lemniscate", seconds=12.0)[0].position_rmse < 1.03 * usual


def test_one_estimate_has_the_force_along_body_z(arpl_250g: Vehicle) -> None:
    """A disturbance across was thrust that was missing as well, where the vehicle leaned against it: both went away."""
    controller = Controller.build(arpl_250g, ControllerOptions.for_vehicle(arpl_250g, adaptation=ON))
    assert controller.adaptation is not None
    controller.solver.disturbance[:3] = 4.0, -1.0, 0.5
    leaning = HOVER.copy()
    leaning[6:10] = np.cos(0.2), 0.0, np.sin(0.2), 0.0
    assert abs(controller.adaptation.specific_drag(leaning)) < 1e-3


def test_a_model_that_forecasts_worse_than_the_file_s_is_not_flown(arpl_250g: Vehicle) -> None:
    """Velocities that swing faster than the filter expects: it expects them to go on."""
    solver = solver_of(arpl_250g)
    settings = msgspec.structs.replace(ON, linear=msgspec.structs.replace(ON.linear, drift=20.0))
    filtered = FlightFilter(solver, settings)
    state, speed = HOVER.copy(), np.full((1, 4), arpl_250g.hover_speed)
    filtered.restart(state, 0.0)
    for step in range(1, 400):
        after = HOVER.copy()
        after[3] = 0.05 * np.sin(2 * np.pi * 2.5 * 0.01 * step)
        filtered.follow(state, speed, np.array([0.01]), after, 0.01 * step)
        state = after
    assert filtered.trust[0] == 0.0
    for step in range(400, 1200):
        filtered.follow(HOVER, speed, np.array([0.01]), HOVER, 0.01 * step)
    assert filtered.trust[0] == 1.0


@pytest.mark.parametrize("jump", [3.0, np.nan])
def test_a_velocity_that_jumps_moves_nothing(arpl_250g: Vehicle, jump: float) -> None:
    solver = solver_of(arpl_250g, "rotor_drag")
    filtered = FlightFilter(solver, ON, followed_parameters(solver.model, ["rotor_drag"]))
    speed, jumped = np.full((1, 4), arpl_250g.hover_speed), HOVER.copy()
    jumped[VELOCITY] += jump
    filtered.restart(HOVER, 0.0)
    for step in range(1, 100):
        filtered.follow(HOVER, speed, np.array([0.01]), HOVER, 0.01 * step)
    filtered.follow(HOVER, speed, np.array([0.01]), jumped, 1.0)
    filtered.follow(jumped, speed, np.array([0.01]), HOVER, 1.01)
    filtered.follow(HOVER, speed, np.array([0.01]), HOVER, 1.02)
    assert filtered.rejected >= 1
    assert np.isfinite(filtered.deviations).all()
    assert filtered.values[0] == 0.0
    assert np.abs(filtered.staying + filtered.fading).max() < 0.05


def test_what_is_estimated_is_bounded(arpl_250g: Vehicle) -> None:
    filtered = FlightFilter(solver_of(arpl_250g), ON)
    speed, state = np.full((1, 4), arpl_250g.hover_speed), HOVER.copy()
    filtered.restart(state, 0.0)
    for step in range(1, 300):
        after = state.copy()
        after[3] += 0.2  # 20 m/s^2
        filtered.follow(state, speed, np.array([0.01]), after, 0.01 * step)
        state = after
    assert abs(filtered.staying[0] + filtered.fading[0]) <= ON.linear.limit + 1e-12


@pytest.mark.slow
def test_a_restart_of_the_solver_forgets_nothing_that_holds(arpl_250g: Vehicle) -> None:
    """A solver without a solution for a while restarts at every tick; after a long pause the air is another."""
    controller = flown(arpl_250g, "Hover", *WIND, seconds=2.0)[1]
    assert controller.adaptation is not None
    before, now = controller.adaptation.followed.disturbance, controller.adaptation.newest
    for tick in range(3):
        controller.reset(HOVER, now + 0.01 * tick)
    assert controller.adaptation.followed.disturbance == before
    controller.reset(HOVER, now + 20.0)
    assert controller.adaptation.followed.disturbance == (0.0,) * 6
    assert not controller.solver.disturbance[:12].any()


@pytest.mark.parametrize("name", ["no_such_effect", "weak_rotor", "gust", "imu_bias"])
def test_what_cannot_be_followed_is_refused(arpl_250g: Vehicle, name: str) -> None:
    with pytest.raises(RequestError, match=name):
        with_followed(arpl_250g, [name])


def test_a_mass_is_left_to_the_effectiveness_of_thrust(arpl_250g: Vehicle) -> None:
    """What the effectiveness left of 15 % was followed as a mass of 3 +- 0.2 %."""
    flight, controller = flown(arpl_250g, "Lemniscate", EffectUse("mass", {"ratio": 1.15}), follow=("mass",))
    assert flight.position_rmse < 0.04
    assert controller.adaptation is not None
    filtered = controller.adaptation.filter
    assert filtered.values[0] == 1.0
    assert filtered.deviations[0] > 0.15


def test_a_kernel_of_an_older_version_is_refused(arpl_250g: Vehicle) -> None:
    solver = solver_of(arpl_250g)
    solver.follows = False
    with pytest.raises(RequestError, match="Export the model again"):
        Adaptation(solver, ON, thrust_constants=solver.model.thrust_constants, period=0.01)


def test_bounds_and_priors_are_the_effects_own(arpl_250g: Vehicle) -> None:
    model = build_model(with_followed(arpl_250g, ["rotor_drag"]))
    (parameter,) = followed_parameters(model, ["rotor_drag"])
    declared = CATALOGUE["rotor_drag"].parameters[0]
    assert (parameter.lower, parameter.upper) == (declared.lower, declared.upper)
    assert parameter.std == declared.prior(arpl_250g).std
    assert parameter.value == 0.0


def acted(commands: Sequence[tuple[float, np.ndarray]], lag: float, hover: np.ndarray, time: float) -> np.ndarray:
    """Rotor speeds behind the commands' lag of first order at a time, each command in the mean of its 10 ms."""
    response, speed = hover.copy(), hover.copy()
    for at, command in commands:
        if at > time:
            break
        left = np.exp(-0.01 / lag) if lag else 0.0
        speed = command + (1 - left) * lag / 0.01 * (response - command)
        response = command + left * (response - command)
    return speed


@pytest.mark.parametrize("lag", [0.0, 0.025])
def test_a_forecast_is_by_the_commands_that_acted(arpl_250g: Vehicle, lag: float) -> None:
    """Also where one left with less thrust, where the ring of commands has turned, and across a part of a period."""
    first, second = solver_of(arpl_250g), solver_of(arpl_250g)
    random, hover = np.random.default_rng(3), np.full(4, arpl_250g.hover_speed)
    by_commands, by_segments = FlightFilter(first, ON), FlightFilter(second, ON)
    commands = [(0.01 * k, hover * random.uniform(0.9, 1.1, 4)) for k in range(150)]
    constants, shares = first.model.thrust_constants, {3: 0.8, 148: 0.7}
    first.begin_thrust(hover, lag=lag, period=0.01)
    scaled = []
    for tick, (time, speed) in enumerate(commands):
        share = shares.get(tick)
        thrust = np.nan if share is None else share * float(constants @ speed**2)
        first.add_thrust(time, speed, thrust)
        scaled.append((time, speed if share is None else np.sqrt(share) * speed))
    before, after = HOVER.copy(), HOVER + np.r_[np.zeros(3), 0.1, 0.0, 0.05, np.zeros(7)]
    for filtered in (by_commands, by_segments):
        filtered.restart(before, 1.464)
    edges = np.array([1.464, 1.47, 1.48, 1.485])
    speeds = [acted(scaled, lag, hover, (a + b) / 2) for a, b in pairwise(edges)]
    by_segments.follow(before, speeds, np.diff(edges), after, 1.485)
    by_commands.follow_commands(before, 1.464, after, 1.485)
    np.testing.assert_allclose(first.filter_state, second.filter_state, rtol=1e-9, atol=1e-12)
    first.clear_thrust()
    for solver, filtered in ((first, by_commands), (second, by_segments)):
        solver.clear_filter()
        filtered.restart(before, 2.0)
    by_commands.follow_commands(before, 2.0, after, 2.02)
    by_segments.follow(before, [hover], [0.02], after, 2.02)
    np.testing.assert_allclose(first.filter_state, second.filter_state, rtol=1e-9, atol=1e-12)


def test_a_command_of_rotors_that_stand_is_no_hole_in_the_history(arpl_250g: Vehicle) -> None:
    """Nothing scales it to a thrust; what is commanded later is followed."""
    solver, hover = solver_of(arpl_250g), np.full(4, arpl_250g.hover_speed)
    filtered = FlightFilter(solver, ON)
    solver.begin_thrust(hover, lag=0.025, period=0.01)
    solver.add_thrust(0.0, np.zeros(4), 0.5)
    for tick in range(1, 50):
        solver.add_thrust(0.01 * tick, hover, np.nan)
    filtered.restart(HOVER, 0.47)
    filtered.follow_commands(HOVER, 0.47, HOVER, 0.48)
    assert filtered.rejected == 0
    np.testing.assert_allclose(filtered.staying + filtered.fading, 0.0, atol=1e-3)
