"""Windows of a flight simulated open loop from measured states, many at once.

Between two rows the rotors' speeds, or commands, change linearly, about the mean that the segment has; where their
speed is measured the rotors accelerate as measured. Faults of sensors that the model holds are removed from the
readings first.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, replace

import casadi as ca
import msgspec
import numpy as np

from diagnosis.data.filters import advanced
from diagnosis.data.segment import Segment
from diagnosis.models.batched_function import RowFunction
from diagnosis.models.predictor import MAX_KEPT, Predictor
from dynamics import quaternion
from dynamics.arrays import Floats
from dynamics.effect import Effect, Expression
from dynamics.integrators import exponential_steps, relaxation_of, with_unit_attitude
from dynamics.model import Model, build_model
from dynamics.state import HIDDEN, RATE, RIGID_BODY_STATES
from dynamics.vehicle import Vehicle

PARAMETERS, PERIOD = 3, 5  # places among the step's inputs that all rows share


@dataclass(frozen=True, eq=False)
class SimulatedWindows:
    """W windows of n steps, simulated.

    states: (W, n + 1, nx).
    inputs: (W, n, 2 rotors), speeds and accelerations.
    environment: (W, n, 2).
    rows: (W, n + 1) rows of the segment.
    """

    states: Floats
    inputs: Floats
    environment: Floats
    rows: np.ndarray[tuple[int, int], np.dtype[np.int64]]


class Simulator:
    """The step of a predictor's model at one rate, over many windows at once."""

    def __init__(self, predictor: Predictor, rate: float, *, speed_measured: bool) -> None:
        self.predictor = predictor
        self._period = np.array([1 / rate])
        self._speed_measured = speed_measured

    def run(self, starts: Sequence[tuple[Segment, Sequence[int]]], steps: int, p: Floats) -> list[SimulatedWindows]:
        """Simulate windows from the measured states at some rows of segments without faults.

        States are not finite where the rate is too low for the model's hidden states.
        """
        parts = [self._at_start(segment, rows, steps, p) for segment, rows in starts]
        states, inputs, environment = (
            np.concatenate(values) for values in zip(*((w.states, w.inputs, w.environment) for w in parts), strict=True)
        )
        simulated_step, half = self._compiled(p), inputs.shape[2] // 2
        for step in range(steps):
            u, a, e = inputs[:, step, :half], inputs[:, step, half:], environment[:, step]
            if simulated_step is None:
                states[:, step + 1] = np.nan
            else:
                states[:, step + 1] = simulated_step(states[:, step], u, a, p, e, self._period, a * self._period)
        edges = np.cumsum([len(w.states) for w in parts[:-1]])
        return [replace(w, states=part) for w, part in zip(parts, np.split(states, edges), strict=True)]

    def _at_start(self, segment: Segment, starts: Sequence[int], steps: int, p: Floats) -> SimulatedWindows:
        """Windows of which the first states alone are filled."""
        measured = self.predictor.states(segment, p)
        rows = np.asarray(starts, dtype=np.int64)[:, None] + np.arange(steps + 1)
        here, there = rows[:, :-1], rows[:, 1:]
        share = 0.5 if segment.rotor_share is None else segment.rotor_share
        before, after = segment.rotor_speed[here], segment.rotor_speed[there]
        speed = (1 - share) * before + share * after
        acceleration = (after - before) * segment.rate
        states = np.empty((len(rows), steps + 1, measured.shape[1]))
        states[:, 0] = measured[rows[:, 0]]
        return SimulatedWindows(states, np.concatenate([speed, acceleration], axis=2), segment.environment[here], rows)

    def _compiled(self, p: Floats) -> RowFunction | None:
        """With as many substeps as the hidden states need; None if more than are taken."""
        count = self.predictor.substeps(float(self._period[0]), p)
        if count is None:
            return None
        return _step_function(self.predictor.model, count, speed_measured=self._speed_measured)


def healthy(
    vehicle: Vehicle, catalogue: Mapping[str, Effect], segments: Sequence[Segment]
) -> tuple[Vehicle, list[Segment]]:
    """The vehicle without faults of sensors, and segments as faultless sensors at its centre of mass had read them."""
    read = [use for use in vehicle.effects if catalogue[use.name].measurement is not None]
    if not read:
        return vehicle, list(segments)
    model = build_model(vehicle, effects=read, catalogue=catalogue)
    rest = tuple(use for use in vehicle.effects if use not in read or catalogue[use.name].moves_vehicle)
    return msgspec.structs.replace(vehicle, effects=rest), [_without_faults(s, model) for s in segments]


def _without_faults(segment: Segment, model: Model) -> Segment:
    """The segment without the model's sensor faults, which are affine in the body rate and in each rotor's speed."""
    nothing, still, p = np.zeros(3), np.zeros(model.input_count), model.parameter_values

    def read(rate: Floats, speed: Floats) -> list[Floats]:
        return [np.array(reading).ravel() for reading in model.measure(nothing, rate, speed, p, nothing)]

    _, rate, speed, age, attitude_age, arm, axes, rotor_age = read(nothing, still)
    slope = np.column_stack([read(axis, still)[1] - rate for axis in np.eye(3)])
    gain = read(nothing, still + 1)[2] - speed
    gyro = None
    if segment.gyro is not None:
        gyro = np.asarray((quaternion.rotate(axes, segment.gyro) - rate) @ np.linalg.inv(slope).T, dtype=float)
    posed = _with_pose_of(segment, float(age[0]), float(age[0] + attitude_age[0]))
    to_world = np.asarray(quaternion.rotation_matrix(posed.attitude))
    rate_body = posed.rate_from_attitude if gyro is None else gyro
    return replace(
        posed,
        gyro=gyro,
        rotor_speed=(advanced(segment.rotor_speed, segment.rate, float(rotor_age[0])) - speed) / gain,
        position=posed.position - to_world @ arm,
        velocity=posed.velocity - np.einsum("nij,nj->ni", to_world, np.cross(rate_body, arm)),
    )


def _with_pose_of(segment: Segment, age: float, attitude_age: float) -> Segment:
    """The segment with the pose that was logged `age` s later; the last rows repeat the last one."""
    time = np.arange(len(segment)) / segment.rate

    def moved(values: Floats, later: float) -> Floats:
        return np.stack([np.interp(time + later, time, column) for column in values.T], axis=1)

    attitude = moved(segment.attitude, attitude_age)
    attitude /= np.linalg.norm(attitude, axis=1, keepdims=True)
    return replace(
        segment, position=moved(segment.position, age), velocity=moved(segment.velocity, age), attitude=attitude
    )


_functions: dict[Hashable, RowFunction] = {}


def _step_function(model: Model, count: int, *, speed_measured: bool) -> RowFunction:
    """State one row later of a model, (nx,); one function for all models of its structure."""
    key = (model.structure, count, speed_measured)
    if key not in _functions:
        if len(_functions) >= MAX_KEPT:
            _functions.clear()
        inputs, after = _step(model, speed_measured, count)
        _functions[key] = RowFunction(ca.Function("step", inputs, [ca.cse(after)]), shared=(PARAMETERS, PERIOD))
    return _functions[key]


def _step(model: Model, speed_measured: bool, count: int) -> tuple[list[Expression], Expression]:
    """Symbols (x, u, a, p, e, dt, c) and the state one row later, in `count` steps.

    u: mean speeds, or commands, over the step. a: the rotors' acceleration. c: change of u over the step.
    """
    sizes = {"x": model.state_count, "u": model.input_count, "a": model.input_count, "p": len(model.parameter_names)}
    x, u, a, p = (ca.SX.sym(name, size) for name, size in sizes.items())
    e, dt, still = ca.SX.sym("e", 2), ca.SX.sym("dt"), ca.SX.zeros(model.hidden_count)
    change = ca.SX.sym("c", model.input_count)

    def field(state: Expression, share: float) -> Expression:
        now = u + (share - 0.5) * change
        rates = model.derivative(state, now, p, e, still)
        if not speed_measured:
            return rates
        _, angular = model.respond(state, now, a, p, e)  # with the moment of rotors that speed up
        return ca.vertcat(rates[: RATE.start], angular, rates[HIDDEN])

    hidden = ca.SX.sym("hidden", model.hidden_count)
    apart = ca.vertcat(x[:RIGID_BODY_STATES], hidden)
    relaxation = ca.substitute(relaxation_of(field(apart, 0.0)[HIDDEN], hidden), hidden, x[HIDDEN])
    everything = ca.vertcat(ca.SX.zeros(RIGID_BODY_STATES), relaxation)
    after = exponential_steps(field, x, everything, dt, steps=count)
    return [x, u, a, p, e, dt, change], ca.densify(with_unit_attitude(after))
