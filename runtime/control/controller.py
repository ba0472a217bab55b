"""The controller: RTI model predictive control of rotor speeds, sent to the autopilot as body rates and thrust.

A pure object: time is an argument. A tick is `feedback`, as soon as a state has arrived, then, once the command has
left, `prepare` for the next tick.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, NamedTuple

import msgspec
import numpy as np

from dynamics.arrays import Floats
from dynamics.autopilot_settings import AutopilotSettings
from dynamics.controller_defaults import lookaheads, unmodelled_thrust_lag
from dynamics.controller_settings import CONTROL_PERIOD
from dynamics.effect import Effect
from dynamics.effects import CATALOGUE
from dynamics.rate_loop import rate_loop
from dynamics.state import ATTITUDE, POSITION, RATE, RIGID_BODY_STATES, VELOCITY
from dynamics.vehicle import Vehicle
from runtime.control.adaptation import Adaptation
from runtime.control.adaptation_settings import AdaptationSettings
from runtime.control.bundle import Bundle
from runtime.control.followed_parameters import with_followed
from runtime.control.history import ColumnHistory
from runtime.control.kernel_model import FlownModel
from runtime.control.model_health import FitLimits, ModelHealth, TrainingRange
from runtime.control.network_features import NetworkFeatures, read_features
from runtime.control.rti.prebuilt import flown_model
from runtime.control.rti.problem import DEFAULTS, Problem
from runtime.control.rti.solver import CUT, SOLVED, RtiSolver

HISTORY = 64  # ticks of inputs stored for delay compensation
MIN_SHARE = 0.5  # of the network's output, below which it counts as not flown
MAX_STEP = 0.05  # s; longer gaps are propagated in pieces, each within RK4's reach


class ControllerOptions(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Complete options of a controller, as a recording keeps them; `for_vehicle` derives them from a vehicle.

    problem: cost, horizon and bounds.
    period: expected time between ticks, s.
    rate_lookahead: time along the slope of the body rates at which roll and pitch rate setpoints are read, s: the delay
        of the autopilot's rate loop.
    yaw_lookahead: the same of the yaw rate, s.
    setpoint: the slope: that of the prediction's first node, or the angular acceleration that its inputs command, which
        differs where the model's rotors lag. The former is that of recordings without the key.
    delay: from a command's departure to its action, s; added to the age of every estimate.
    max_position_error: distance, m, to which the position error is limited; a linearisation does not reach further.
    fit: when a learned model does not fit any more.
    adaptation: how the model follows in flight.
    """

    problem: Problem = Problem()
    period: float = CONTROL_PERIOD
    rate_lookahead: float
    yaw_lookahead: float
    setpoint: Literal["predicted", "commanded"] = "predicted"
    delay: float = DEFAULTS.delay
    max_position_error: float = msgspec.field(default=DEFAULTS.max_position_error, name="largest_error")
    fit: FitLimits = FitLimits()
    adaptation: AdaptationSettings = AdaptationSettings()

    @classmethod
    def for_vehicle(
        cls,
        vehicle: Vehicle,
        *,
        period: float | None = None,
        adaptation: AdaptationSettings | None = None,
        gains: AutopilotSettings | None = None,
        catalogue: Mapping[str, Effect] = CATALOGUE,
    ) -> ControllerOptions:
        """The options of a vehicle's [controller]. period: s, instead of its rate's. adaptation: but for its lags.

        gains: of the autopilot's rate loop; None for those of the vehicle file, else ones that suit its motors.
        """
        settings, lookahead = vehicle.controller, lookaheads(vehicle, catalogue, gains)
        return cls(
            problem=Problem.from_settings(settings),
            period=period or 1 / settings.rate,
            rate_lookahead=lookahead.rate,
            yaw_lookahead=lookahead.yaw,
            setpoint="commanded",
            delay=settings.delay,
            max_position_error=settings.max_position_error,
            adaptation=msgspec.structs.replace(
                adaptation or AdaptationSettings(),
                thrust_lag=unmodelled_thrust_lag(vehicle, catalogue),
                motor_lag=rate_loop(vehicle, catalogue=catalogue).motor_lag,
            ),
        )

    def for_autopilot(self, vehicle: Vehicle, gains: AutopilotSettings) -> ControllerOptions:
        """The options with the lookaheads of a vehicle whose autopilot has these gains, unless its file has them."""
        lookahead = lookaheads(vehicle, gains=gains)
        return msgspec.structs.replace(self, rate_lookahead=lookahead.rate, yaw_lookahead=lookahead.yaw)

    def for_kernel(self, compiled: Problem) -> ControllerOptions:
        """Options with the nodes and intervals of a compiled kernel; in place of a default problem the kernel's own."""
        grid = {"nodes": compiled.nodes, "horizon": compiled.horizon, "growth": compiled.growth}
        problem = msgspec.structs.replace(self.problem, **grid)
        return msgspec.structs.replace(self, problem=compiled if self.problem == Problem() else problem)


class CommandHistory(NamedTuple):
    """The last commands of a controller, by turns: command k is at k % HISTORY.

    times: (HISTORY,) s, when they acted. inputs: (HISTORY, n) rad/s. hidden: (HISTORY, m) the model's hidden states
    then. total: so far.
    """

    times: Floats
    inputs: Floats
    hidden: Floats
    total: int


@dataclass(frozen=True)
class Command:
    """The setpoint of one tick.

    rate_body: (3,) rad/s, body FLU.
    collective_thrust: N.
    rotor_speed: (n,) rad/s, the optimal input from which they follow.
    status: of the solver, SOLVED or CUT where it has an answer.
    seconds: of the feedback.
    """

    rate_body: Floats
    collective_thrust: float
    rotor_speed: Floats
    status: int
    seconds: float

    @property
    def fault(self) -> str:
        """Why it must not be sent, empty when it may be."""
        if not math.isfinite(float(self.rate_body.sum()) + self.collective_thrust):
            return "the solution is not finite"
        return "" if self.status in (SOLVED, CUT) else f"status {self.status}"

    @property
    def cut(self) -> bool:
        """Whether the solver's iterations ran out: inputs keep their bounds, the rest is not quite the optimum."""
        return self.status == CUT


@dataclass(frozen=True)
class Answer:
    """A feedback that `alula_tick` has computed with a controller's solver.

    measured: (nx,) the whole state at the estimate.
    acting: (nx,) the same when the command acts.
    command: before the flight's limits.
    """

    measured: Floats
    acting: Floats
    command: Command


class Controller:
    """RTI MPC for one vehicle; states are rigid-body states (13,) in our frames, times in seconds of one clock.

    trim: the vehicle without effects that has the model's weight and thrust in hover.
    max_step: s that the model is propagated in one piece.
    """

    def __init__(
        self, model: FlownModel, options: ControllerOptions, bundle: Bundle | None = None, library: Path | None = None
    ) -> None:
        """bundle: of the model; its kernel is the solver. library: compiled code of the model, without a bundle."""
        self.model, self.options = model, options
        self.solver = RtiSolver(model, options.problem, library if bundle is None else bundle.kernel)
        self.max_step = MAX_STEP
        self._columns: ColumnHistory | None = None
        if bundle is not None and bundle.manifest.learned:
            manifest = bundle.manifest
            self.max_step = manifest.dt
            self._columns = ColumnHistory(len(self.solver.history), manifest.dt, model.input_count)
            self._range = TrainingRange.from_bundle(bundle)
            errors = manifest.errors
            self.health = ModelHealth(errors.get("linear", 0.0), errors.get("angular", 0.0), options.fit)
        self._acting = 0.0  # s, when the last tick's command acts
        self._thrust_constants = model.thrust_constants
        self._offsets = options.problem.offsets
        trim = self.solver.trim
        self.trim = trim.vehicle
        self._hover, self._shares = trim.rotor_speed, trim.shares  # rad/s; of the hover speed, by rotor
        self._times = np.full(HISTORY, -np.inf)
        self._inputs = np.tile(self._hover, (HISTORY, 1))
        self._hidden = np.tile(model.hidden_initial, (HISTORY, 1))
        self._ticks = 0
        self._has_hidden = model.hidden_count > 0
        self._state = model.initial_state(np.array([*[0.0] * 6, 1.0, *[0.0] * 6]))
        self._command_states = self.solver.states[:2]
        self._leads_lag = options.setpoint == "commanded" and len(self.solver.rotor_speed_places) > 0
        self.use_lookaheads(options)
        self._settled = self._state.copy()
        self.adaptation: Adaptation | None = None
        if options.adaptation.mode != "off":
            self.adaptation = Adaptation(
                self.solver,
                options.adaptation,
                thrust_constants=self._thrust_constants,
                period=options.period,
                learned=self._columns is not None,
                features=_features(bundle, options.adaptation),
            )

    @classmethod
    def build(
        cls, vehicle: Vehicle, options: ControllerOptions | None = None, catalogue: Mapping[str, Effect] = CATALOGUE
    ) -> Controller:
        """The controller of a vehicle with the effects of its file in the model; compiles unless cached."""
        options = options or ControllerOptions.for_vehicle(vehicle, catalogue=catalogue)
        if options.adaptation.mode != "off":
            vehicle = with_followed(vehicle, options.adaptation.follow, catalogue)
        return cls(flown_model(vehicle, catalogue), options)

    @classmethod
    def from_bundle(cls, bundle: Bundle, options: ControllerOptions | None = None) -> Controller:
        """The controller of an exported model, with the horizon that its kernel was compiled for."""
        options = (options or ControllerOptions.for_vehicle(bundle.vehicle)).for_kernel(bundle.manifest.problem)
        return cls(bundle.model, options, bundle)

    @classmethod
    def fallback_from_bundle(cls, bundle: Bundle, options: ControllerOptions | None = None) -> Controller | None:
        """The fallback of a learned model: the controller of the vehicle file's model. None where no network flies."""
        if not bundle.manifest.learned:
            return None
        options = (options or ControllerOptions.for_vehicle(bundle.vehicle)).for_kernel(bundle.manifest.problem)
        return cls(bundle.vehicle_model, options, library=bundle.physics)

    def use_lookaheads(self, options: ControllerOptions) -> None:
        """Look ahead as far as other options say from now on."""
        lookahead = np.array([options.rate_lookahead, options.rate_lookahead, options.yaw_lookahead])
        self.options = msgspec.structs.replace(
            self.options, rate_lookahead=options.rate_lookahead, yaw_lookahead=options.yaw_lookahead
        )
        self._lead: Floats = lookahead  # s
        self._lookahead: Floats = lookahead / self.options.problem.node  # in intervals as the first

    @property
    def is_learned(self) -> bool:
        """Whether the model is a network's."""
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
        """A learned model's running error over its error in training; NaN for a nominal or identified one."""
        return math.nan if self._columns is None else self.health.ratio

    @property
    def uncertainty(self) -> float:
        """The members' disagreement at the last tick over what one validation row in 100 exceeds; NaN without any."""
        return float(self.solver.certainty[0])

    @property
    def network_share(self) -> float:
        """Share of the network's output that predictions have; NaN for a nominal or identified model."""
        return math.nan if self._columns is None else float(self.solver.certainty[1])

    def node_times(self, time: float) -> Floats:
        """(N + 1,) times of the reference for a tick at a time: from when its command acts."""
        return time + self.options.delay + self._offsets

    def reset(self, state: Floats, time: float) -> None:
        """Restart from a state: hover inputs, no history."""
        self._times[:] = -np.inf
        self._inputs[:], self._hidden[:] = self._hover, self.model.hidden_initial
        self._ticks = 0
        self._state[:RIGID_BODY_STATES] = state
        self._state[RIGID_BODY_STATES:] = self.model.hidden_initial
        self.solver.reset(self._state)
        if self._columns is not None:
            self._columns.clear()
            self.health.reset()
        if self.adaptation is not None:
            self.adaptation.reset(time)
        self._acting = time
        self._remember(time, self._hover)

    def compensate(self, state: Floats, taken: float, now: float) -> Floats:
        """The whole state now of a rigid-body state (13,) measured earlier, by the model and the inputs since.

        The next call overwrites the returned array.
        """
        predicted = None
        if self._columns is not None:
            state, predicted = self._take(self._columns, taken, state)
        last = (self._ticks - 1) % HISTORY
        oldest = max(0, self._ticks - HISTORY)
        tick = self._ticks - 1
        while tick > oldest and self._times[tick % HISTORY] > taken:
            tick -= 1
        self._state[:RIGID_BODY_STATES] = state
        self._state[RIGID_BODY_STATES:] = self._hidden[tick % HISTORY]
        if self._has_hidden:  # they are those of the moment at which that tick's command began to act
            lag = min(taken - self._times[tick % HISTORY], MAX_STEP)
            self._propagate(self._inputs[tick % HISTORY], lag, taken - lag, keep=False)
            self._state[:RIGID_BODY_STATES] = state
        if self.adaptation is not None:
            self.adaptation.measure(taken, self._state, predicted)
        time = taken
        while tick < self._ticks - 1:
            until = min(self._times[(tick + 1) % HISTORY], now)
            self._propagate(self._inputs[tick % HISTORY], until - time, time)
            time, tick = max(time, until), tick + 1
        self._propagate(self._inputs[last], now + self.options.delay - time, time)
        return self._state

    def feedback(self, state: Floats, time: float) -> Command:
        """The command for a state (nx,) from `compensate`; the tick's urgent half.

        One that must not be sent does not count as acting.
        """
        status = self.solver.feedback(state)
        speed = self.solver.inputs[0].copy()
        rate = self._rate_setpoint(speed, time + self.options.delay)
        command = Command(rate, self._thrust_of(speed), speed, status, self.solver.report.feedback_seconds)
        self._take_state(state, time)
        if not command.fault:
            self._remember(self._acting, speed)
        return command

    def take(self, answer: Answer, taken: float, now: float) -> Command:
        """The command of a feedback that this solver has given already, for an estimate of the time `taken`."""
        if self.adaptation is not None:
            self.adaptation.measure(taken, answer.measured, None)
        self._take_state(answer.acting, now)
        self._remember(self._acting, answer.command.rotor_speed)
        return answer.command

    @property
    def commands(self) -> CommandHistory:
        """The commands so far, views."""
        return CommandHistory(self._times, self._inputs, self._hidden, self._ticks)

    @property
    def leads(self) -> tuple[Floats, Floats, bool]:
        """How far rate setpoints look ahead, (3,) s and (3,) nodes, and whether along the commanded slope."""
        return self._lead, self._lookahead, self._leads_lag

    @property
    def thrust_constants(self) -> Floats:
        """(n,) N s^2/rad^2."""
        return self._thrust_constants

    def _thrust_of(self, speed: Floats) -> float:
        """Thrust of all rotors, N, summed one after the other, as `alula_tick` does. speed: (n,) rad/s."""
        thrust = 0.0
        for value in (speed * speed * self._thrust_constants).tolist():
            thrust += value
        return thrust

    def _rate_setpoint(self, speed: Floats, acting: float) -> Floats:
        """The body rates (3,), rad/s, to command for the rotor speeds (nu,), rad/s, that act from a time on, s.

        They look ahead along the angular acceleration that these inputs command. Where the model lags, the prediction's
        slope is what earlier inputs left: the rate loop would be told of a plan when the model has carried it out.
        """
        now = self._command_states[0, RATE]
        if not self._leads_lag:
            return np.asarray(now + self._lookahead * (self._command_states[1, RATE] - now))
        self._settled[:] = self._command_states[0]
        for place in self.solver.rotor_speed_places:
            self._settled[place] = speed
        step = min(self.options.problem.node, self.max_step)
        if self._columns is not None:
            self._columns.write_columns(acting, self.solver.history)
        settled = self.solver.propagate(self._settled, speed, step)[RATE]
        return np.asarray(now + self._lead / step * (settled - now))

    def sent(self, collective_thrust: float, time: float, effectiveness: float) -> None:
        """Tell what left at a tick, s: N, also where it is not what this controller commanded.

        effectiveness: thrust per modelled thrust.
        """
        if self.adaptation is not None:
            self.adaptation.sent(collective_thrust, time + self.options.delay, effectiveness)

    def collective_thrust(self, rotor_speed: Floats) -> Floats:
        """Thrust of all rotors with the model's effects on each, N. rotor_speed: (..., n) rad/s."""
        return np.asarray((rotor_speed * rotor_speed) @ self._thrust_constants)

    def prepare(self, states: Floats, inputs: Floats) -> None:
        """Linearise for the next tick. states: (N + 1, 13) and inputs: (N, nu), the reference from that tick on.

        Inputs are those of a vehicle without effects; each rotor's is scaled by its trim in hover.
        """
        if self.adaptation is not None:
            self.adaptation.update()
        columns, after = self._columns, self._acting + self.options.period
        if columns is not None:
            columns.write_columns(self._acting, self.solver.history)
        expected = self.solver.propagate(self._state, self.solver.inputs[0], self.options.period)
        if columns is not None:
            columns.add_prediction(after, expected[:RIGID_BODY_STATES])
            columns.write_columns(after, self.solver.history)
        self.solver.shift(self.options.period)
        self.solver.assess(expected, self.solver.inputs[0])
        reference = self.solver.state_reference
        reference[:, :RIGID_BODY_STATES] = states
        if float(states[0, ATTITUDE] @ expected[ATTITUDE]) < 0:
            reference[:, ATTITUDE] = -states[:, ATTITUDE]  # the same attitudes, with the sign of the state's quaternion
        error = reference[0, POSITION] - expected[POSITION]
        distance = math.sqrt(float(error @ error))
        if distance > self.options.max_position_error:
            reference[:, POSITION] -= (1 - self.options.max_position_error / distance) * error
        if _thrust_is_opposed(expected[ATTITUDE], states[0, ATTITUDE]):
            # thrust would only add to their errors: the plan would stop the rotors, whose torque has no slope at rest
            for part in (POSITION, VELOCITY):
                reference[:, part] = self.solver.states[:, part]
        self.solver.input_reference[:] = inputs * self._shares
        self.solver.prepare(expected)

    def keep_warm(self, other: Controller, state: Floats, taken: float, now: float) -> None:
        """Track another controller that flies instead of this one, so that either can take over without a step.

        state: (13,) measured at the time `taken`. Predictions are this controller's own, inputs the other's.
        """
        state_now = self.compensate(state, taken, now)
        self.solver.inputs[:] = other.solver.inputs
        self._take_state(state_now, now)
        self._remember(self._acting, other.solver.inputs[0])

    def model_faults(self, time: float) -> tuple[str, str, str]:
        """Reasons against flying a learned model now: history not filled, input outside of its range, error too large.

        Each is empty where there is none. The latter two count while most of the network is flown: where it has faded,
        the vehicle file's effects fly already, and a fallback to them changes nothing.
        """
        if self._columns is None:
            return "", "", ""
        columns = max(1, self._columns.columns)
        waiting = "" if self._columns.reaches(time) else f"{1e3 * columns * self._columns.dt:.0f} ms"
        if self.network_share < MIN_SHARE:
            return waiting, "", ""
        last, fit = self._columns.last_measured, self.options.fit
        speed = self._inputs[(self._ticks - 1) % HISTORY]
        outside = "" if last is None else self._range.outside(last[1], speed, fit.margin)
        ratio = self.health.ratio
        if not ratio > fit.ratio:
            return waiting, outside, ""
        unsure = f", its members disagree {self.uncertainty:.1f} times as usual" if self.uncertainty > 1 else ""
        return waiting, outside, f"{ratio:.1f} times the training error{unsure}"

    def _take(self, columns: ColumnHistory, taken: float, state: Floats) -> tuple[Floats, Floats | None]:
        """Enter a measured state (13,) into the history, and compare it with the prediction for its time.

        Returns both, the former with its attitude's sign continuous.
        """
        last, predicted = columns.last_measured, columns.prediction_at(taken)
        if last is not None and predicted is not None:
            self.health.compare(predicted, state, taken - last[0])
        return columns.add_measurement(taken, state), predicted

    def _take_state(self, state: Floats, time: float) -> None:
        self._state[:] = state
        self._acting = time + self.options.delay

    def _propagate(self, speed: Floats, seconds: float, start: float, *, keep: bool = True) -> None:
        """Propagate the state from a time on. keep: whether its steps go into the history."""
        columns = self._columns
        while seconds > 1e-6:
            step = min(seconds, self.max_step)
            if columns is not None:
                columns.write_columns(start, self.solver.history)
            self._state[:] = self.solver.propagate(self._state, speed, step)
            if keep and self.adaptation is not None:
                self.adaptation.explain(start)
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
        if self.adaptation is not None:
            self.adaptation.command(time, speed)
        self._ticks += 1


def _thrust_is_opposed(attitude: Floats, reference: Floats) -> bool:
    """Whether the thrust axes of two attitudes (4,) are more than a right angle apart."""
    (x, y, z), (a, b, c) = _thrust_axis(attitude), _thrust_axis(reference)
    return x * a + y * b + z * c < 0.0


def _thrust_axis(attitude: Floats) -> tuple[float, float, float]:
    """Body z in world axes, in plain numbers: NumPy takes ten times as long."""
    w, x, y, z = attitude.tolist()
    return 2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)


def _features(bundle: Bundle | None, settings: AdaptationSettings) -> NetworkFeatures | None:
    """The features by which a learned model's last layer follows; None where it does not."""
    if bundle is None or settings.network.mode == "off" or bundle.last_layer is None:
        return None
    return read_features(bundle.last_layer, settings.network.rank)
