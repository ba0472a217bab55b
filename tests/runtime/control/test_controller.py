"""The controller compensates delay with its model, commands what it predicts, and survives bad input."""

import math

import msgspec
import numpy as np
import pytest

from dynamics import quaternion
from dynamics.model import build_model
from dynamics.references import named_reference
from dynamics.vehicle import EffectUse, Vehicle
from dynamics.vehicle_file import with_settings
from runtime.control.controller import Controller, ControllerOptions
from runtime.control.rti.problem import Problem

HOVER = np.array([0.0, 0.0, 1.0, *[0.0] * 3, 1.0, *[0.0] * 6])


def hovering(vehicle: Vehicle, delay: float | None = None) -> Controller:
    options = ControllerOptions.for_vehicle(vehicle)
    if delay is not None:
        options = msgspec.structs.replace(options, delay=delay)
    controller = Controller.build(vehicle, options)
    controller.reset(HOVER, 0.0)
    controller.prepare(np.tile(HOVER, (21, 1)), np.full((20, 4), vehicle.hover_speed))
    return controller


def test_in_hover_it_commands_no_rates_and_the_weight(arpl_250g: Vehicle) -> None:
    controller = hovering(arpl_250g)
    command = controller.feedback(HOVER.copy(), 0.0)
    assert command.status == 0
    np.testing.assert_allclose(command.rate_body, 0, atol=1e-6)
    assert command.collective_thrust == pytest.approx(arpl_250g.weight, rel=1e-6)


@pytest.mark.parametrize(
    "effect", [EffectUse("thrust_constant", {"ratio": 1.25}), EffectUse("weak_rotor", {"ratio": 0.8}, rotor=1)]
)
def test_the_bound_on_thrust_and_the_command_count_the_same_thrust(arpl_250g: Vehicle, effect: EffectUse) -> None:
    limit = 1.3 * arpl_250g.weight
    limits = msgspec.structs.replace(arpl_250g.limits, thrust=(0.5, limit))
    controller = hovering(msgspec.structs.replace(arpl_250g, limits=limits).with_effects(effect))
    above = HOVER.copy()
    above[2] += 0.3
    for tick in range(30):
        command = controller.feedback(controller.compensate(HOVER, 0.01 * tick, 0.01 * tick), 0.01 * tick)
        controller.prepare(np.tile(above, (21, 1)), np.full((20, 4), controller.trim.hover_speed))
    assert command.collective_thrust == pytest.approx(limit, rel=0.01)


def test_the_shifted_solution_continues_the_command(arpl_250g: Vehicle) -> None:
    """The thrust of the prediction is that of the command, on rotors of different strength as well."""
    controller = hovering(arpl_250g.with_effects(EffectUse("weak_rotor", {"ratio": 0.8}, rotor=1)))
    command = controller.feedback(controller.compensate(HOVER, 0.0, 0.0), 0.0)
    predicted = controller.collective_thrust(controller.predicted_inputs)
    assert predicted.shape == (20,)
    assert predicted[0] == command.collective_thrust


@pytest.mark.parametrize("effect", [EffectUse("thrust_constant", {"ratio": 0.8}), EffectUse("mass", {"ratio": 1.3})])
def test_the_command_s_thrust_includes_the_effects_on_the_rotors(arpl_250g: Vehicle, effect: EffectUse) -> None:
    vehicle = arpl_250g.with_effects(effect)
    controller = hovering(vehicle)
    for tick in range(200):
        state = controller.compensate(HOVER, 0.01 * tick, 0.01 * tick)
        command = controller.feedback(state, 0.01 * tick)
        controller.prepare(np.tile(HOVER, (21, 1)), np.full((20, 4), controller.trim.hover_speed))
    weight = build_model(vehicle).mass * 9.81
    assert command.collective_thrust == pytest.approx(weight, rel=1e-3)


def test_a_centre_of_mass_off_the_middle_needs_no_rates_in_hover(arpl_250g: Vehicle) -> None:
    use = EffectUse("centre_of_mass", {"x": 0.006, "y": -0.004, "z": 0.0})
    controller = hovering(arpl_250g.with_effects(use))
    for tick in range(100):
        command = controller.feedback(controller.compensate(HOVER, 0.01 * tick, 0.01 * tick), 0.01 * tick)
        controller.prepare(np.tile(HOVER, (21, 1)), np.full((20, 4), controller.trim.hover_speed))
    np.testing.assert_allclose(command.rate_body, 0, atol=0.02)


@pytest.mark.parametrize(("status", "scale"), [(3, 1.5), (0, np.nan)])
def test_an_answer_that_may_not_be_sent_does_not_count_as_acting(
    arpl_250g: Vehicle, monkeypatch: pytest.MonkeyPatch, status: int, scale: float
) -> None:
    controller = hovering(arpl_250g, delay=0.0)
    controller.feedback(controller.compensate(HOVER, 0.0, 0.0), 0.0)

    def refused(state: np.ndarray) -> int:
        controller.solver.inputs[:] *= scale
        return status

    monkeypatch.setattr(controller.solver, "feedback", refused)
    assert controller.feedback(controller.compensate(HOVER, 0.01, 0.01), 0.01).fault
    np.testing.assert_allclose(controller.compensate(HOVER, 0.01, 0.1), HOVER, atol=1e-6)


def test_an_old_estimate_is_propagated_to_now_by_the_inputs_since(arpl_250g: Vehicle) -> None:
    """A truth flown by the controller's own inputs is recovered from estimates 30 ms old."""
    controller = hovering(arpl_250g, delay=0.0)
    reference = named_reference("circle", arpl_250g)
    truth = reference.states(np.array([0.0]))[0]
    controller.reset(truth, 0.0)
    past = [truth]
    for tick in range(150):
        now = 0.01 * tick
        age = min(3, tick)
        state = controller.compensate(past[-1 - age], now - 0.01 * age, now).copy()
        np.testing.assert_allclose(state, truth, atol=1e-4)
        controller.prepare(
            reference.states(controller.node_times(now)), reference.inputs(controller.node_times(now)[:-1])
        )
        command = controller.feedback(state, now)
        truth = controller.solver.propagate(truth, command.rotor_speed, 0.01).copy()
        past.append(truth)


def test_a_delay_shifts_state_and_reference_alike(arpl_250g: Vehicle) -> None:
    late = hovering(arpl_250g, delay=0.02)
    moving = HOVER.copy()
    moving[3] = 2.0
    assert late.compensate(moving, 5.0, 5.0)[0] == pytest.approx(0.04, abs=1e-6)
    assert late.node_times(5.0)[0] == pytest.approx(5.02)


def test_hidden_states_of_the_model_follow_the_inputs(arpl_250g: Vehicle) -> None:
    vehicle = arpl_250g.with_effects(EffectUse("motor_lag", {"time_constant": 0.03}))
    controller = hovering(vehicle, delay=0.0)
    climb = np.tile(HOVER, (21, 1))
    climb[:, 2] = 3.0
    state = controller.compensate(HOVER, 0.0, 0.0)
    controller.prepare(climb, np.full((20, 4), vehicle.hover_speed))
    command = controller.feedback(state, 0.0)
    after = controller.compensate(HOVER, 0.0, 0.03)
    expected = command.rotor_speed + (vehicle.hover_speed - command.rotor_speed) * np.exp(-1)
    np.testing.assert_allclose(after[13:], expected, rtol=1e-3)


def test_hidden_states_keep_time_between_old_estimates_and_ticks(arpl_250g: Vehicle) -> None:
    """A load swings for two seconds; it is not measured, and estimates are 13 ms old at ticks of 10 ms."""
    vehicle = arpl_250g.with_effects(EffectUse("slung_load", {"mass": 0.02, "length": 0.5}))
    controller = hovering(vehicle, delay=0.0)
    controller.reset(HOVER, 0.0)
    truth, inputs = [controller.model.initial_state(HOVER)], [controller.trim.hover_speed * np.ones(4)]
    target = np.tile(HOVER, (21, 1))
    for tick in range(200):
        now = 0.01 * tick
        old = controller.solver.propagate(truth[-3], inputs[-2], 0.007)[:13].copy() if tick > 1 else truth[0][:13]
        state = controller.compensate(old, max(now - 0.013, 0.0), now).copy()
        np.testing.assert_allclose(state[13:16], truth[-1][13:16], atol=0.02)
        target[:, 0] = 0.5 * np.sin(3.0 * (now + np.arange(21) * 0.05))
        controller.prepare(target, np.full((20, 4), controller.trim.hover_speed))
        inputs.append(controller.feedback(state, now).rotor_speed)
        truth.append(controller.solver.propagate(truth[-1], inputs[-1], 0.01).copy())
    assert np.max(np.abs(np.array(truth)[:, 16])) > 0.3  # it did swing


def test_a_reference_far_away_is_approached_and_not_blown_up(arpl_250g: Vehicle) -> None:
    controller = hovering(arpl_250g)
    far = np.tile(HOVER, (21, 1))
    far[:, 0] = 30.0
    truth, tilts, statuses = HOVER.copy(), [], []
    for tick in range(800):
        state = controller.compensate(truth, 0.01 * tick, 0.01 * tick)
        command = controller.feedback(state, 0.01 * tick)
        controller.prepare(far, np.full((20, 4), arpl_250g.hover_speed))
        truth = controller.solver.propagate(truth, command.rotor_speed, 0.01).copy()
        tilts.append(1 - 2 * (truth[7] ** 2 + truth[8] ** 2))
        statuses.append(command.status)
    assert not any(statuses)
    assert min(tilts) > 0  # never beyond 90 degrees
    assert truth[0] > 15
    assert abs(truth[1]) < 0.5


@pytest.mark.parametrize("degrees", [150.0, 178.0, 180.0, -178.0])
@pytest.mark.parametrize("axis", [0, 1])
def test_a_start_upside_down_turns_upright_and_comes_back(arpl_250g: Vehicle, axis: int, degrees: float) -> None:
    """There thrust adds to the error of position, and rotors that stand still have no slope by which to turn."""
    controller = hovering(arpl_250g)
    angles = [0.0, 0.0, 0.0]
    angles[axis] = math.radians(degrees)
    state = HOVER.copy()
    state[6:10] = quaternion.from_euler(*angles)
    controller.reset(state, 0.0)
    reference, speeds = np.tile(HOVER, (21, 1)), np.full((20, 4), arpl_250g.hover_speed)
    controller.prepare(reference, speeds)
    lowest = state[2]
    for tick in range(200):
        command = controller.feedback(controller.compensate(state, 0.01 * tick, 0.01 * tick), 0.01 * tick)
        state = controller.solver.propagate(state, command.rotor_speed, 0.01).copy()
        controller.prepare(reference, speeds)
        lowest = min(lowest, state[2])
    assert quaternion.rotate(state[6:10], np.array([0.0, 0.0, 1.0]))[2] > 0.99
    assert lowest > HOVER[2] - 3.0


def test_the_other_sign_of_the_quaternion_is_the_same_attitude(arpl_250g: Vehicle) -> None:
    commands = []
    for sign in (1.0, -1.0):
        controller = Controller.build(arpl_250g)
        state = HOVER.copy()
        state[6:10] *= sign
        controller.reset(state, 0.0)
        target = np.tile(HOVER, (21, 1))
        target[:, 0] = 0.5
        controller.prepare(target, np.full((20, 4), arpl_250g.hover_speed))
        commands.append(controller.feedback(state, 0.0))
    np.testing.assert_allclose(commands[0].rate_body, commands[1].rate_body, atol=1e-9)


def test_a_broken_state_keeps_the_previous_solution(arpl_250g: Vehicle) -> None:
    controller = hovering(arpl_250g)
    broken = HOVER.copy()
    broken[5] = np.nan
    command = controller.feedback(broken, 0.0)
    assert command.status == -1
    assert np.isfinite(command.rate_body).all()
    assert command.collective_thrust == pytest.approx(arpl_250g.weight, rel=1e-6)


def test_unknown_options_are_refused() -> None:
    with pytest.raises(msgspec.ValidationError):
        msgspec.convert({"problem": {"nodez": 10}, "rate_lookahead": 0.1, "yaw_lookahead": 0.1}, ControllerOptions)


def test_options_are_those_of_the_vehicles_file(arpl_250g: Vehicle) -> None:
    settings = ["controller.horizon=0.8", "controller.terminal_weight=5", "controller.max_position_error=1.0"]
    options = ControllerOptions.for_vehicle(with_settings(arpl_250g, [*settings, "controller.rate=200"]))
    assert (options.problem.horizon, options.problem.weights.terminal, options.period) == (0.8, 5.0, 0.005)
    assert msgspec.json.decode(msgspec.json.encode(options), type=ControllerOptions) == options
    assert b'"largest_error":1.0' in msgspec.json.encode(options)  # as older recordings have it


def test_a_reference_is_asked_for_at_the_nodes_whatever_their_intervals(arpl_250g: Vehicle) -> None:
    growing = with_settings(arpl_250g, ["controller.nodes=8", "controller.growth=1.3"])
    controller = Controller.build(growing)
    times = controller.node_times(2.0)
    np.testing.assert_allclose(np.diff(times), controller.options.problem.intervals)
    assert times[0] == 2.0 + controller.options.delay


def test_a_kernel_keeps_its_horizon_and_takes_the_files_weights(arpl_250g: Vehicle) -> None:
    compiled = Problem(nodes=10, horizon=0.5, growth=1.1)
    assert ControllerOptions.for_vehicle(arpl_250g).for_kernel(compiled).problem == compiled
    heavier = with_settings(arpl_250g, ["controller.attitude_weight=16"])
    problem = ControllerOptions.for_vehicle(heavier).for_kernel(compiled).problem
    assert (problem.nodes, problem.horizon, problem.growth, problem.weights.attitude) == (10, 0.5, 1.1, 16.0)
