"""The vehicle's model with effects along a reference: responses, readings, and slopes in state, rotors and parameters.

The sensors' faults are those of `dynamics.effect.Reading`; the readings are compared in body axes.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from diagnosis.likelihood.flight_rows import FlightRows, Reference
from diagnosis.likelihood.gain import decoupled, unread
from diagnosis.likelihood.hidden_states import HiddenStates
from diagnosis.likelihood.innovations import Linearised
from diagnosis.models.batched_function import RowFunction
from dynamics import quaternion
from dynamics.arrays import Floats
from dynamics.effect import Effect
from dynamics.model import Model, build_model
from dynamics.rotation_matrix import exponential, logarithm, orthonormal, skew
from dynamics.vehicle import GRAVITY, EffectUse, Vehicle

PARAMETERS = 7  # place of the parameters among the inputs
OUTPUTS: Mapping[str, slice] = {  # of the functions; the rotors' readings and their age follow
    "force": slice(0, 3),
    "turning": slice(3, 6),
    "accelerometer": slice(6, 9),
    "gyro": slice(9, 12),
    "velocity": slice(12, 15),
    "attitude": slice(15, 18),
}
SPEEDS = 18
# of a period after the row before: where a line has its effect on a rate that is read in the middle of a row (3/4), or
# as its mean (5/6)
BEFORE_READING = 0.8
START_STEP, PARAMETER_STEP = 0.01, 1e-5  # deviations, and relative: of differences for slopes of hidden states
MAX_SAVED = 256
_functions: dict[Hashable, RowFunction] = {}


@dataclass(frozen=True, eq=False)
class Along:
    """The model along a flight about a reference.

    reference: at the rows' ends. rotation, rate, velocity: at their middles.
    speed, spin_up: (N, rotors) rad/s and rad/s^2 of the rotors. lag: s behind their commands, None without.
    force: (N, 3) specific force. turning: (N, 3) angular acceleration.
    slope: (N, 6, 9) of both in the error state; by_rotor (N, 6, rotors).
    defect: (N, 9 or 9 + 2 rotors) where a row's model ends, less the reference there.
    difference: (N, m) readings less the model's.
    hidden: (N, h) hidden states of effects.
    model: for the filter.
    """

    reference: Reference
    velocity: Floats
    rotation: Floats
    rate: Floats
    speed: Floats
    spin_up: Floats
    lag: float | None
    force: Floats
    turning: Floats
    slope: Floats
    by_rotor: Floats
    defect: Floats
    difference: Floats
    hidden: Floats
    model: Linearised


class FlightModel:
    """A vehicle's model with effects, for the filter.

    uses: its effects; a lag of the rotors acts on the speeds, and is none of the functions'.
    """

    def __init__(self, vehicle: Vehicle, uses: Sequence[EffectUse], catalogue: Mapping[str, Effect]) -> None:
        lags = [use for use in uses if catalogue[use.name].rotor_speed is not None]
        self.uses = [use for use in uses if use not in lags]
        self.model: Model = build_model(vehicle, effects=self.uses, catalogue=catalogue)
        self.hidden = HiddenStates(self.model)
        self.lag = sum(use.parameters["time_constant"] for use in lags) or None if lags else None

    def speeds(self, rows: FlightRows, reference: Reference) -> tuple[Floats, Floats]:
        """(N, rotors) speeds of the rotors in the rows, and their acceleration."""
        if "rotor_speed" in rows.readings:
            speed, slope = np.split(reference.rotors[:-1], 2, axis=1)
            return speed + rows.period / 2 * slope, slope
        speed = rows.rotor_speed(self.lag)
        return speed, np.gradient(speed, rows.period, axis=0)

    def along(
        self, rows: FlightRows, reference: Reference, hover_force: Floats, starts: Mapping[str, float] | None = None
    ) -> Along:
        """The model along a flight. hover_force: about which the noise's transition is constant. starts: of hidden
        states. Raises LinAlgError where these cannot be followed."""
        dt, count = rows.period, self.model.vehicle.rotors.count
        speed, spin_up = self.speeds(rows, reference)
        early = speed if "rotor_speed" in rows.readings else before_reading(speed)
        v, R, w = reference.velocity[:-1], reference.rotation[:-1], reference.rate[:-1]
        hidden = self.hidden_path(rows, self.driving(rows, reference), starts or {})
        if not np.isfinite(hidden).all():
            raise np.linalg.LinAlgError("hidden states of the model are not finite along a flight")
        start = self._evaluated(rows, v, R, w, early, spin_up, (), hidden)[:, :6]
        v_half = v + dt / 2 * (np.einsum("tij,tj->ti", R, start[:, :3]) - [0, 0, GRAVITY])
        R_half = R @ exponential(dt / 2 * w + dt**2 / 8 * start[:, 3:])
        w_half = w + dt / 2 * start[:, 3:]
        out = self._evaluated(rows, v_half, R_half, w_half, speed, spin_up, (), hidden)
        force, turning = out[:, OUTPUTS["force"]], out[:, OUTPUTS["turning"]]
        slopes = out[:, SPEEDS + count + 1 :].reshape(len(rows), 6 + count, 6).transpose(0, 2, 1)
        slope = np.zeros((len(rows), 6, 9))
        slope[:, :, :3] = slopes[:, :, :3] @ R_half
        body_velocity = np.einsum("tji,tj->ti", R_half, v_half)
        slope[:, :, 3:6] = slope[:, :, :3] @ skew(body_velocity)
        slope[:, :, 6:] = slopes[:, :, 3:6]
        v_next = v + dt * (np.einsum("tij,tj->ti", R_half, force) - [0, 0, GRAVITY])
        R_next = R @ exponential(dt * w_half)
        w_next = w + dt * turning
        after = reference.velocity[1:], reference.rotation[1:], reference.rate[1:]
        defect = np.concatenate(
            [
                np.einsum("tji,tj->ti", after[1], v_next - after[0]),
                logarithm(np.swapaxes(after[1], 1, 2) @ R_next),
                w_next - after[2],
            ],
            axis=1,
        )
        if "rotor_speed" in rows.readings:
            before, slope_before = np.split(reference.rotors, 2, axis=1)
            moved = np.concatenate([before[:-1] + dt * slope_before[:-1], slope_before[:-1]], axis=1)
            defect = np.concatenate([defect, moved - reference.rotors[1:]], axis=1)
        A, C = _transition(slope, force, w_half, dt, rows.readings, count)
        still = unread(rows.readings)
        decoupled(A, still, 1.0 - dt)
        C[:, :, still], defect[:, still] = 0.0, 0.0
        difference = self._difference(rows, v_half, R_half, spin_up, out)
        conditions = np.concatenate([force - hover_force, w_half], axis=1)
        model = Linearised(A, C, np.ascontiguousarray(conditions))
        motion = (reference, v_half, R_half, w_half, speed, spin_up, self.lag, force, turning)
        return Along(*motion, slope, slopes[:, :, 6:], defect, difference, hidden, model)

    def driving(self, rows: FlightRows, reference: Reference) -> Floats:
        """(N, 13 + rotors + 2) what drives hidden states in the rows' middles; empty without any."""
        if not self.hidden.count:
            return np.zeros((len(rows), 0))
        R, w = reference.rotation[:-1], reference.rate[:-1]
        v_half, w_half = (values[:-1] / 2 + values[1:] / 2 for values in (reference.velocity, reference.rate))
        q = quaternion.from_rotation_matrix(R @ exponential(rows.period / 2 * w))
        return np.hstack([rows.position, v_half, q, w_half, self.speeds(rows, reference)[0], rows.environment])

    def hidden_path(
        self, rows: FlightRows, driving: Floats, starts: Mapping[str, float], values: Floats | None = None
    ) -> Floats:
        """(N, h) hidden states along a flight, not finite where its rows are too far apart for them.

        They begin where the part of the flight before ends, or in hover. starts: offsets there, by name. values: of the
        parameters instead of the model's.
        """
        p = self.model.parameter_values if values is None else values
        start = self.hidden.begins_at({})
        if rows.before is not None and self.hidden.count:
            before = self.driving(rows.before, rows.before.measured_reference())
            start = self.hidden.path(before, rows.period, start, p)[-1]
        start = start + self.hidden.begins_at(starts) - self.hidden.begins_at({})
        return self.hidden.path(driving, rows.period, start, p)

    def parameter_slopes(self, rows: FlightRows, along: Along, free: Sequence[str], hidden: Floats) -> Floats:
        """(N, k, 19 + rotors) slopes of the outputs in parameters, by the model's names, with hidden states as given.

        hidden: (N, h).
        """
        motion = (along.velocity, along.rotation, along.rate, along.speed, along.spin_up)
        values = self._evaluated(rows, *motion, free, hidden)
        return values.reshape(len(rows), len(free), values.shape[1] // max(len(free), 1))

    def hidden_slope(
        self, rows: FlightRows, along: Along, driving: Floats, starts: Mapping[str, float], name: str, here: Floats
    ) -> Floats:
        """(N, 19 + rotors) slope of the outputs in a parameter on which the hidden states depend, or in one of their
        starts: the difference to a value nearby. here: the outputs at the present one."""
        p, begins = self.model.parameter_values.copy(), dict(starts)
        if name in self.hidden.starts:
            step = START_STEP * self.hidden.starts[name][1]
            begins[name] = starts.get(name, 0.0) + step
        else:
            place = self.model.parameter_index(name)
            step = self._step(name, p[place])
            p[place] += step
        path = self.hidden_path(rows, driving, begins, p)
        return np.asarray((self.outputs(rows, along, path, p) - here) / step)

    def outputs(self, rows: FlightRows, along: Along, hidden: Floats, values: Floats | None = None) -> Floats:
        """(n, 19 + rotors) the model's outputs with hidden states (n, h) as given, of a flight's first n rows."""
        n, count = len(hidden), along.speed.shape[1]
        v, R, w = along.velocity[:n], along.rotation[:n], along.rate[:n]
        made = self._evaluated(rows, v, R, w, along.speed[:n], along.spin_up[:n], (), hidden, values)
        return made[:, : SPEEDS + count + 1]

    def _step(self, name: str, value: float) -> float:
        """From a parameter's value to one nearby, within its bounds."""
        key, own = name.rsplit(".", 1)
        parameter = next(
            p for item in self.model.effects if item.key == key for p in item.effect.parameters if p.name == own
        )
        step = PARAMETER_STEP * (abs(value) or parameter.prior(self.model.vehicle).std)
        return step if value + step <= parameter.upper else -step

    def _evaluated(
        self,
        rows: FlightRows,
        v: Floats,
        R: Floats,
        w: Floats,
        speed: Floats,
        spin_up: Floats,
        free: Sequence[str],
        hidden: Floats,
        values: Floats | None = None,
    ) -> Floats:
        q, p = quaternion.from_rotation_matrix(R), self.model.parameter_values if values is None else values
        function = _function(self.model, tuple(free))
        states = (hidden,) if hidden.shape[1] else ()
        return function(v, q, w, rows.position[: len(v)], speed, spin_up, rows.environment[: len(v)], p, *states)

    def _difference(self, rows: FlightRows, v: Floats, R: Floats, spin_up: Floats, out: Floats) -> Floats:
        """(N, m) readings less the model's, in body axes."""
        count = self.model.vehicle.rotors.count
        parts: dict[str, Callable[[], Floats]] = {
            "velocity": lambda: np.einsum("tji,tj->ti", R, rows.velocity - v) - out[:, OUTPUTS["velocity"]],
            "attitude": lambda: logarithm(np.swapaxes(R, 1, 2) @ rows.rotation) - out[:, OUTPUTS["attitude"]],
            "gyro": lambda: np.asarray(rows.rate - out[:, OUTPUTS["gyro"]]),
            "accelerometer": lambda: np.asarray(rows.force - out[:, OUTPUTS["accelerometer"]]),
            "rotor_speed": lambda: np.asarray(
                rows.rotor_speed(None) - out[:, SPEEDS : SPEEDS + count] + spin_up * out[:, [SPEEDS + count]]
            ),
        }
        return np.concatenate([parts[kind]() for kind in rows.readings], axis=1)


def before_reading(values: Floats) -> Floats:
    """(N, ...) what acts in a row until it is read, by the rows before it alone.

    A controller answers a row's turbulence within it. Commands of the row itself would explain a part of its readings'
    noise, which an inertia or a lag would gain by.
    """
    early = values.copy()
    early[2:] = (1 + BEFORE_READING) * values[1:-1] - BEFORE_READING * values[:-2]
    return early


def moved_reference(reference: Reference, states: Floats) -> Reference:
    """A reference moved by errors of velocity, attitude and rate (N, n) at the rows' starts."""
    width = 9 + reference.rotors.shape[1]
    error = np.concatenate([states[:, :width], states[-1:, :width]])
    velocity = reference.velocity + np.einsum("tij,tj->ti", reference.rotation, error[:, :3])
    rotation = orthonormal(reference.rotation @ exponential(error[:, 3:6]))
    return Reference(velocity, rotation, reference.rate + error[:, 6:9], reference.rotors + error[:, 9:])


def _transition(
    slope: Floats, force: Floats, rate: Floats, dt: float, readings: Sequence[str], rotors: int
) -> tuple[Floats, Floats]:
    """(N, 9, 9) transition of the error state over a row, and (N, m, 9) means of the readings in that at its start."""
    F = np.zeros((len(slope), 9, 9))
    turn = skew(rate)
    F[:, 0:3] = slope[:, :3]
    F[:, 0:3, 0:3] -= turn
    F[:, 0:3, 3:6] -= skew(force)
    F[:, 3:6, 3:6] = -turn
    F[:, 3:6, 6:9] = np.eye(3)
    F[:, 6:9] = slope[:, 3:]
    squared = F @ F
    A = np.eye(9) + dt * F + dt**2 / 2 * squared
    mean = np.eye(9) + dt / 2 * F + dt**2 / 6 * squared
    parts = {"velocity": mean[:, 0:3], "attitude": mean[:, 3:6], "gyro": mean[:, 6:9]}
    if "accelerometer" in readings:
        parts["accelerometer"] = slope[:, :3] @ mean
    if "rotor_speed" in readings:
        parts["rotor_speed"] = np.zeros((len(slope), rotors, 9))
    return np.ascontiguousarray(A), np.ascontiguousarray(np.concatenate([parts[kind] for kind in readings], axis=1))


def _function(model: Model, free: tuple[str, ...]) -> RowFunction:
    """(v, q, w, position, speed, change of speed, environment, p, hidden states if any) -> outputs and their slopes in
    v, w and speed; or slopes in free parameters."""
    key = (model.structure, free)
    if key not in _functions:
        if len(_functions) >= MAX_SAVED:
            _functions.clear()
        count = model.vehicle.rotors.count
        sizes = {"v": 3, "q": 4, "w": 3, "position": 3, "u": count, "a": count, "e": 2, "p": len(model.parameter_names)}
        if model.hidden_count:
            sizes["hidden"] = model.hidden_count
        s = {name: ca.SX.sym(name, size) for name, size in sizes.items()}
        state = ca.vertcat(s["position"], s["v"], s["q"], s["w"], s.get("hidden", ca.SX.zeros(0)))
        force, turning = model.respond(state, s["u"], s["a"], s["p"], s["e"])
        read = model.measure(force, s["w"], s["u"], s["p"], turning)
        accelerometer, rate, speed, age, attitude_age, arm, axes, rotor_age = read
        gyro = quaternion.rotate_inverse(axes, rate)
        gravity = quaternion.rotate_inverse(s["q"], ca.vertcat(0, 0, GRAVITY))
        velocity = ca.cross(s["w"], arm) - (force - gravity) * age
        out = ca.vertcat(
            force, turning, accelerometer, gyro, velocity, -s["w"] * (age + attitude_age), speed, rotor_age
        )
        if free:
            places = [model.parameter_index(name) for name in free]
            result = ca.vec(ca.jacobian(out, s["p"])[:, places])
        else:
            slopes = ca.jacobian(ca.vertcat(force, turning), ca.vertcat(s["v"], s["w"], s["u"]))
            result = ca.vertcat(out, ca.vec(slopes))
        function = ca.Function("model", list(s.values()), [ca.densify(ca.cse(result))])
        _functions[key] = RowFunction(function, shared=(PARAMETERS,))
    return _functions[key]
