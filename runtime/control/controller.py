"""The controller: RTI model predictive control of rotor speeds, given to the autopilot as body rates and thrust.

A pure object: time comes in as an argument. A tick is `feedback` (as soon as a state is there), then, once the
command is on its way, `prepare` for the next tick.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np

from dynamics.arrays import Floats
from dynamics.effect import Effect
from dynamics.effects import CATALOGUE
from dynamics.model import Model, build_model
from dynamics.state import RIGID_BODY_STATES
from dynamics.trim import find_trim
from dynamics.vehicle import Vehicle
from runtime.control.bundle import Bundle
from runtime.control.history import ColumnHistory
from runtime.control.model_health import FitLimits, ModelHealth, TrainingRange
from runtime.control.rti.problem import Problem
from runtime.control.rti.solver import RtiSolver
from runtime.timing import CONTROL_PERIOD

HISTORY = 64  # ticks of inputs stored for delay compensation
MAX_STEP = 0.05  # s; longer gaps are propagated in pieces, each within RK4's reach


class ControllerOptions(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """How the controller runs. period: expected time between ticks, s.

    rate_lookahead, yaw_lookahead: how far ahead along the prediction's slope the body rates are read that the
    autopilot is asked for, s; they make up for the time its rate loops take, which is longest in yaw (with yaw rates
    read 75 ms ahead the mock of PX4's SIH swings by a radian in hover). delay: from a command's departure to its
    action, s, added to the age of every estimate. largest_error: the reference is drawn towards a vehicle further away
    than this, m, because a linearisation does not reach that far. fit: when a learned model is not trusted.
    """

    problem: Problem = Problem()
    period: float = CONTROL_PERIOD
    rate_lookahead: float = 0.075
    yaw_lookahead: float = 0.3
    delay: float = 0.005
    largest_error: float = 2.0
    fit: FitLimits = FitLimits()


@dataclass(frozen=True)
class Command:
    """What the vehicle is asked for. rate_body: (3,) rad/s, body FLU. collective_thrust: N.

    rotor_speed: (n,) rad/s, the optimal input behind them. status: the solver's, 0 when it solved its problem.
    """

    rate_body: Floats
    collective_thrust: float
    rotor_speed: Floats
    status: int
    seconds: float


class Controller:
    """RTI MPC for one vehicle; states are rigid-body states (13,) in our frames, times in seconds of one clock.

    trim: the vehicle without effects that weighs and thrusts as the model does in hover.
    """

    def __init__(
        self, model: Model, options: ControllerOptions, bundle: Bundle | None = None, library: Path | None = None
    ) -> None:
        """bundle: of the model, whose kernel then solves. library: compiled code of the model, without a bundle."""
        self.model, self.options = model, options
        self.solver = RtiSolver(model, options.problem, library if bundle is None else bundle.kernel)
        self._longest = MAX_STEP
        self._columns: ColumnHistory | None = None
        if bundle is not None and bundle.manifest.learned:
            manifest = bundle.manifest
            self._longest = manifest.dt
            self._columns = ColumnHistory(len(self.solver.history), manifest.dt, model.input_count)
            self._range = TrainingRange.from_bundle(bundle)
            errors = manifest.errors
            self.health = ModelHealth(errors.get("linear", 0.0), errors.get("angular", 0.0), options.fit)
        self._acting = 0.0  # when the state of the last tick was
        self._thrust_constants = model.thrust_constants
        self._offsets: Floats = options.problem.node * np.arange(options.problem.nodes + 1, dtype=np.float64)
        trim = find_trim(model)
        self.trim = trim.vehicle
        self._hover, self._shares = trim.rotor_speed, trim.shares
        self._times = np.full(HISTORY, -np.inf)
        self._inputs = np.tile(self._hover, (HISTORY, 1))
        self._hidden = np.tile(model.hidden_initial, (HISTORY, 1))
        self._ticks = 0
        self._has_hidden = model.hidden_count > 0
        self._state = model.initial_state(np.array([*[0.0] * 6, 1.0, *[0.0] * 6]))
        seconds = (options.rate_lookahead, options.rate_lookahead, options.yaw_lookahead)
        self._lookahead = np.array(seconds) / options.problem.node
        self._command_states = self.solver.states[: min(2, options.problem.nodes + 1)]

    @classmethod
    def build(
        cls, vehicle: Vehicle, options: ControllerOptions | None = None, catalogue: Mapping[str, Effect] = CATALOGUE
    ) -> Controller:
        """The controller of a vehicle with the effects of its file in the model; compiles unless cached."""
        return cls(build_model(vehicle, catalogue=catalogue), options or ControllerOptions())

    @classmethod
    def from_bundle(cls, bundle: Bundle, options: ControllerOptions | None = None) -> Controller:
        """The controller of an exported model, with the horizon that its kernel was built for."""
        options = msgspec.structs.replace(options or ControllerOptions(), problem=bundle.manifest.problem)
        return cls(bundle.model, options, bundle)

    @classmethod
    def fallback_from_bundle(cls, bundle: Bundle, options: ControllerOptions | None = None) -> Controller | None:
        """The physical model's controller to fall back to from a learned one, None where a physical one flies."""
        if not bundle.manifest.learned:
            return None
        options = msgspec.structs.replace(options or ControllerOptions(), problem=bundle.manifest.problem)
        return cls(build_model(bundle.vehicle), options, library=bundle.physics)

    @property
    def is_learned(self) -> bool:
        """Whether a network predicts."""
        return self._columns is not None

    @property
    def predicted_states(self) -> Floats:
        """(N + 1, nx) states of the current prediction."""
        return self.solver.states

    @property
    def predicted_inputs(self) -> Floats:
        """(N, nu) rotor speeds of the current prediction, rad/s."""
        return self.solver.inputs

    @property
    def fit_ratio(self) -> float:
        """A learned model's running error over its error in training, NaN for a physical one."""
        return math.nan if self._columns is None else self.health.ratio

    def node_times(self, time: float) -> Floats:
        """(N + 1,) times of the reference that a tick at a time looks at: from when its command acts."""
        return time + self.options.delay + self._offsets

    def reset(self, state: Floats, time: float) -> None:
        """Start anew from a state: hover inputs, no history."""
        self._times[:] = -np.inf
        self._inputs[:], self._hidden[:] = self._hover, self.model.hidden_initial
        self._ticks = 0
        self._state[:RIGID_BODY_STATES] = state
        self._state[RIGID_BODY_STATES:] = self.model.hidden_initial
        self.solver.reset(self._state)
        if self._columns is not None:
            self._columns.clear()
            self.health.reset()
        self._acting = time
        self._remember(time, self._hover)

    def compensate(self, state: Floats, taken: float, now: float) -> Floats:
        """The whole state now of a rigid-body state (13,) taken earlier, by the model and the inputs since given.

        The array returned is used again by the next call.
        """
        if self._columns is not None:
            state = self._take(self._columns, taken, state)
        last = (self._ticks - 1) % HISTORY
        oldest = max(0, self._ticks - HISTORY)
        tick = self._ticks - 1
        while tick > oldest and self._times[tick % HISTORY] > taken:
            tick -= 1
        self._state[:RIGID_BODY_STATES] = state
        self._state[RIGID_BODY_STATES:] = self._hidden[tick % HISTORY]
        if self._has_hidden:  # they were left where that tick's command began to act
            lag = min(taken - self._times[tick % HISTORY], MAX_STEP)
            self._propagate(self._inputs[tick % HISTORY], lag, taken - lag, keep=False)
            self._state[:RIGID_BODY_STATES] = state
        time = taken
        while tick < self._ticks - 1:
            until = min(self._times[(tick + 1) % HISTORY], now)
            self._propagate(self._inputs[tick % HISTORY], until - time, time)
            time, tick = max(time, until), tick + 1
        self._propagate(self._inputs[last], now + self.options.delay - time, time)
        return self._state

    def feedback(self, state: Floats, time: float) -> Command:
        """The command for a state (nx,) as `compensate` gives it; the tick's urgent half."""
        status = self.solver.feedback(state)
        speed = self.solver.inputs[0].copy()
        self._acted(state, time, speed)
        now, then = self._command_states[0, 10:13], self._command_states[1, 10:13]
        rate = now + self._lookahead * (then - now)
        thrust = float(self._thrust_constants @ (speed * speed))
        return Command(rate, thrust, speed, status, self.solver.report.feedback_seconds)

    def prepare(self, states: Floats, inputs: Floats) -> None:
        """Linearise for the next tick. states: (N + 1, 13) and inputs: (N, nu), the reference from that tick on.

        Inputs are those of a vehicle without effects; each rotor's is scaled as its trim in hover asks for.
        """
        columns, after = self._columns, self._acting + self.options.period
        if columns is not None:
            columns.write_columns(self._acting, self.solver.history)
        expected = self.solver.propagate(self._state, self.solver.inputs[0], self.options.period)
        if columns is not None:
            columns.add_prediction(after, expected[:RIGID_BODY_STATES])
            columns.write_columns(after, self.solver.history)
        self.solver.shift(self.options.period)
        reference = self.solver.state_reference
        reference[:, :RIGID_BODY_STATES] = states
        if float(states[0, 6:10] @ expected[6:10]) < 0:
            reference[:, 6:10] = -states[:, 6:10]  # the same attitudes, on the side where the state's quaternion is
        error = reference[0, 0:3] - expected[0:3]
        distance = math.sqrt(float(error @ error))
        if distance > self.options.largest_error:
            reference[:, 0:3] -= (1 - self.options.largest_error / distance) * error
        self.solver.input_reference[:] = inputs * self._shares
        self.solver.prepare(expected)

    def keep_warm(self, other: Controller, state: Floats, taken: float, now: float) -> None:
        """Keep up with another controller that flies in this one's place, so that either can take over without a step.

        state: (13,) taken at a time. Predictions are this one's own, inputs the other's.
        """
        state_now = self.compensate(state, taken, now)
        self.solver.inputs[:] = other.solver.inputs
        self._acted(state_now, now, other.solver.inputs[0])

    def model_faults(self, time: float) -> tuple[str, str, str]:
        """Why a learned model should not fly now: its history is not filled, it is outside of what it knows, it errs.

        Each is empty where there is no reason.
        """
        if self._columns is None:
            return "", "", ""
        columns = max(1, self._columns.columns)
        waiting = "" if self._columns.reaches(time) else f"{1e3 * columns * self._columns.dt:.0f} ms"
        last, fit = self._columns.last_measured, self.options.fit
        speed = self._inputs[(self._ticks - 1) % HISTORY]
        outside = "" if last is None else self._range.outside(last[1], speed, fit.margin)
        ratio = self.health.ratio
        return waiting, outside, f"{ratio:.1f} times the training error" if ratio > fit.ratio else ""

    def _take(self, columns: ColumnHistory, taken: float, state: Floats) -> Floats:
        """Enter a measured state (13,) into the history, and hold it against what was predicted for its time."""
        last, predicted = columns.last_measured, columns.prediction_at(taken)
        if last is not None and predicted is not None:
            self.health.compare(predicted, state, taken - last[0])
        return columns.add_measurement(taken, state)

    def _acted(self, state: Floats, time: float, speed: Floats) -> None:
        self._state[:] = state
        self._acting = time + self.options.delay
        self._remember(self._acting, speed)

    def _propagate(self, speed: Floats, seconds: float, start: float, *, keep: bool = True) -> None:
        """Move the state on from a time; keep: its way goes into the history."""
        columns = self._columns
        while seconds > 1e-6:
            step = min(seconds, self._longest)
            if columns is not None:
                columns.write_columns(start, self.solver.history)
            self._state[:] = self.solver.propagate(self._state, speed, step)
            start, seconds = start + step, seconds - step
            if columns is not None and keep:
                columns.add_prediction(start, self._state[:RIGID_BODY_STATES])

    def _remember(self, time: float, speed: Floats) -> None:
        slot = self._ticks % HISTORY
        self._times[slot] = time
        self._inputs[slot] = speed
        self._hidden[slot] = self._state[RIGID_BODY_STATES:]
        if self._columns is not None:
            self._columns.add_command(time, speed)
        self._ticks += 1
