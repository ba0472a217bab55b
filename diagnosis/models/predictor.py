"""A model along a measured flight: its predictions at every row, and their slopes.

The expressions are those of `dynamics`; faults of sensors are undone where they spoil the model's inputs (rates,
rotor speeds) and applied where the model predicts a reading (specific force).
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from functools import cached_property, partial

import casadi as ca
import msgspec
import numpy as np

from diagnosis.data.segment import Segment
from diagnosis.models.batched_function import Recurrence, RowFunction
from diagnosis.models.free_start import FreeStart
from diagnosis.models.hidden_path import advance, between, pace_of
from diagnosis.models.prediction import Prediction
from diagnosis.thresholds import DEFAULT, PredictionThresholds
from dynamics import quaternion
from dynamics.arrays import Floats
from dynamics.effect import Effect, Expression
from dynamics.kinematics import lever_arm_acceleration
from dynamics.model import Model, build_model
from dynamics.state import ATTITUDE, HIDDEN, RATE, RIGID_BODY_STATES
from dynamics.vehicle import EffectUse, Vehicle

POSE_AND_VELOCITY = slice(0, ATTITUDE.stop)
BY_MEANS = (slice(3, 6), slice(9, 12))  # of a model's outputs: angular acceleration, and force that the pose shows
PARAMETERS = 4  # place of the parameters among the functions' inputs
MAX_KEPT = 256  # structures whose functions are kept
MAX_FOLLOWED = 24  # sets of hidden states that are kept of a segment
MAX_MOVED = 6  # ages of the rotors' speeds with which a segment is kept


class Predictor:
    """A vehicle's model with effects, evaluated over whole segments.

    uses: the effects in it.
    free: parameters in which slopes are computed, by the model's names.
    speed_measured: whether the segments hold measured rotor speeds; the rotors' lag is then not in the model.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        uses: Sequence[EffectUse],
        catalogue: Mapping[str, Effect],
        free: Sequence[str] = (),
        *,
        speed_measured: bool,
        thresholds: PredictionThresholds = DEFAULT.prediction,
        settled: bool = False,
    ) -> None:
        acting = [use for use in uses if not (speed_measured and catalogue[use.name].rotor_speed is not None)]
        self.model: Model = build_model(vehicle, effects=acting, catalogue=catalogue)
        self.free = tuple(free)
        self._thresholds = thresholds
        self._functions = _functions_of(self.model, self.free)
        self._free_starts = [] if settled else self._make_free_starts(vehicle, catalogue, thresholds)

    @property
    def named_values(self) -> dict[str, float]:
        """The model's parameters."""
        return dict(zip(self.model.parameter_names, self.model.parameter_values.tolist(), strict=True))

    def values(self, changed: Mapping[str, float] | None = None) -> Floats:
        """The model's parameter vector with some of them changed."""
        p = self.model.parameter_values.copy()
        for name, value in (changed or {}).items():
            p[self.model.parameter_index(name)] = value
        return p

    def predict(self, segment: Segment, changed: Mapping[str, float] | None = None) -> Prediction:
        """The model's prediction along a segment."""
        p, ages = self._values_and_ages(changed)
        outputs = self._evaluated(self._functions.evaluate, _at_age(segment, ages[2]), p)
        return Prediction.from_outputs(outputs[:, 0], ages)

    def slopes(
        self,
        segment: Segment,
        changed: Mapping[str, float] | None = None,
        *,
        free: Sequence[str] | None = None,
    ) -> list[Prediction]:
        """Derivatives of the prediction in each free parameter. free: those of these parameters alone."""
        names = self.free if free is None else tuple(free)
        p, ages = self._values_and_ages(changed)
        parts = self._evaluated(_functions_of(self.model, names).slopes, _at_age(segment, ages[2]), p)
        return [Prediction.from_outputs(part, ages) for part in parts.transpose(1, 0, 2)]

    def _evaluated(self, function: RowFunction, segment: Segment, p: Floats) -> Floats:
        """(n, k, 12) outputs of a function, or their slopes.

        The logged rotor speeds act on velocities and rates by their mean over the periods about a row. An accelerometer
        reads the rotors of its instant.
        """
        values = _by_prediction(function(*self._arguments(segment, p, segment.rotor_speed)))
        if segment.rotor_share is None:
            return values
        of_means = _by_prediction(function(*self._arguments(segment, p, segment.mean_rotor_speed)))
        for place in BY_MEANS:
            values[:, :, place] = of_means[:, :, place]
        return values

    def _values_and_ages(self, changed: Mapping[str, float] | None) -> tuple[Floats, Floats]:
        p = self.values(changed)
        return p, self._functions.ages(p)

    def states(self, segment: Segment, p: Floats | None = None) -> Floats:
        """(n, nx) measured motion, smoothed, and the hidden states along it. p: parameters, by default the model's.

        Hidden states are not finite where the rate is too low for them.
        """
        values = self.values() if p is None else p
        if not self.model.hidden_count:
            return segment.smooth
        return self._states(_at_age(segment, self._rotor_age(values)), values)

    def _rotor_age(self, p: Floats) -> float:
        return float(self._functions.ages(p)[2])

    def _states(self, segment: Segment, values: Floats) -> Floats:
        """(n, nx) the same along a segment whose rotors' speeds have the age of its other rows."""
        if not self.model.hidden_count:
            return segment.smooth
        initial = self._initial(segment, values)
        hidden = segment.workspace.get(
            "hidden states",
            self._hidden_key(segment, values, initial),
            lambda: self._hidden(segment, values, initial),
            limit=MAX_FOLLOWED,
        )
        return np.vstack([segment.smooth.T, hidden.T]).T

    def settled(self, segment: Segment) -> Floats:
        """(h,) hidden states in hover, with the rotors at the speeds at a segment's start."""
        hidden = self.model.hidden_initial.copy()
        for place in self.model.rotor_speed_places:
            hidden[place.start - RIGID_BODY_STATES : place.stop - RIGID_BODY_STATES] = segment.rotor_speed[0]
        return hidden

    def predict_from(
        self, segment: Segment, changed: Mapping[str, float], starts: Sequence[Floats]
    ) -> list[Prediction]:
        """The model's predictions along a segment at whose start the hidden states are (h,) each of the starts."""
        p, ages = self._values_and_ages(changed)
        moved, count = _at_age(segment, ages[2]), len(starts)
        hidden = np.vstack([self._hidden(moved, p, start) for start in starts])
        states = np.vstack([np.tile(moved.smooth.T, count), hidden.T]).T
        motion = (moved.body_rate, moved.rotor_speed, moved.rotor_acceleration, moved.environment)
        rate, speed, acceleration, environment = (np.tile(values.T, count).T for values in motion)
        turning = np.tile(moved.angular_acceleration.T, count).T
        outputs = self._functions.evaluate(states, rate, speed, acceleration, p, environment, turning)
        return [Prediction.from_outputs(part, ages) for part in np.split(outputs, count)]

    def _initial(self, segment: Segment, p: Floats) -> Floats:
        """(h,) hidden states at a segment's start: those of hover, or where the first seconds show them to begin."""
        initial = self.settled(segment)
        for start, names, places in self._free_starts:
            initial[places] = start.of(segment, {name: float(p[self.model.parameter_index(name)]) for name in names})
        return initial

    def _make_free_starts(
        self, vehicle: Vehicle, catalogue: Mapping[str, Effect], thresholds: PredictionThresholds
    ) -> list[tuple[FreeStart, tuple[str, ...], list[int]]]:
        """Of each effect that may begin in mid-motion: its start, the parameters that it depends on, and its places.

        The rotors' lag is not in it: motions that slow see the thrust of some 0.05 s before.
        """
        starts, bare = [], msgspec.structs.replace(vehicle, effects=())
        slower = msgspec.structs.replace(thresholds, hidden_rate=thresholds.free_start_rate)
        for item in self.model.effects:
            spread = {hidden.name: hidden.start_std for hidden in item.effect.hidden if hidden.start_std}
            if spread:
                use = EffectUse(item.effect.name, rotor=item.rotor)
                alone = Predictor(bare, [use], catalogue, speed_measured=True, thresholds=slower, settled=True)
                inner = alone.model.effects[0]
                places = [place for name in spread for place in _places(inner.hidden[name])]
                sizes = np.array(list(spread.values()))
                start = FreeStart(item.effect, item.key, alone, places, sizes, vehicle, thresholds)
                own = [place for name in spread for place in _places(item.hidden[name])]
                starts.append((start, alone.model.parameter_names, own))
        return starts

    def _hidden_key(self, segment: Segment, p: Floats, initial: Floats) -> Hashable:
        """Key of the hidden states along a segment: equal in all models whose hidden states are equal."""
        stride = self._stride(segment, p)
        own = p[self._functions.hidden_parameters].tobytes(), initial.tobytes()
        return (self._functions.hidden_slope, *own, stride, self.substeps(stride / segment.rate, p))

    def _arguments(self, segment: Segment, p: Floats, speed: Floats) -> list[Floats]:
        acceleration, angular = segment.rotor_acceleration, segment.angular_acceleration
        return [self._states(segment, p), segment.body_rate, speed, acceleration, p, segment.environment, angular]

    def substeps(self, period: float, p: Floats) -> int | None:
        """Integration steps over a period, s, that hidden states need; None if more than are taken."""
        return self._functions.pace.substeps(period, p, self._thresholds)

    def _stride(self, segment: Segment, p: Floats) -> int:
        """Rows from one step of the hidden states to the next: all where they are fast, or the rotors'."""
        if self.model.rotor_speed_places:
            return 1
        return self._functions.pace.stride(segment.rate, p, self._thresholds)

    def _hidden(self, segment: Segment, p: Floats, initial: Floats) -> Floats:
        """(n, h) hidden states along the segment, from (h,) initial ones."""
        stride = self._stride(segment, p)
        count = self.substeps(stride / segment.rate, p)
        if count is None:
            return np.full((len(segment), self.model.hidden_count), np.nan)
        here = segment.driving[::stride]
        period = np.array([stride / segment.rate])
        with np.errstate(all="ignore"):
            hidden = np.vstack([initial, self._functions.advance(count)(initial, here[:-1], here[1:], p, period)])
        return between(hidden, stride, len(segment))


def _by_prediction(columns: Floats) -> Floats:
    """(n, k, 12) from (n, 12 k)."""
    return columns.reshape(len(columns), columns.shape[1] // 12, 12)


def _at_age(segment: Segment, age: float) -> Segment:
    """The segment with the rotors' speeds that were logged `age` s later."""
    if age == 0.0:
        return segment
    return segment.workspace.get("at age", age, lambda: segment.with_rotors_later(age), limit=MAX_MOVED)


class _Functions:
    """Functions of the predictors of one structure and one set of free parameters, each made when first needed."""

    def __init__(self, model: Model, free: Sequence[str]) -> None:
        self._model, self._symbols = model, _symbols(model)
        self._places = [model.parameter_index(name) for name in free]
        ages = ca.densify(_ages(model, self._symbols["p"]))
        self._ages = np.array(ca.DM(ages)).ravel() if ages.is_constant() else None  # where no effect has one
        self._ages_at = ca.Function("ages", [self._symbols["p"]], [ages])
        self.pace = pace_of(model)
        self.hidden_slope, self.hidden_parameters = _hidden_slope_text(model)
        self._advances: dict[int, Recurrence] = {}

    @cached_property
    def _outputs(self) -> Expression:
        return _outputs(self._model, self._symbols)

    def _by_row(self, outputs: Expression) -> RowFunction:
        function = ca.Function("outputs", list(self._symbols.values()), [ca.densify(outputs)])
        return RowFunction(function, shared=(PARAMETERS,))

    @cached_property
    def evaluate(self) -> RowFunction:
        """The outputs (12,)."""
        return self._by_row(self._outputs)

    @cached_property
    def slopes(self) -> RowFunction:
        """Their derivatives in each free parameter, (12 k,)."""
        slopes = ca.jacobian(self._outputs, self._symbols["p"])[:, self._places]
        return self._by_row(ca.cse(ca.vec(slopes)))

    def ages(self, p: Floats) -> Floats:
        """(3,) age of the pose, of the attitude beyond it, and of the rotors' speeds, s."""
        return np.array(self._ages_at(p)).ravel() if self._ages is None else self._ages

    def advance(self, count: int) -> Recurrence:
        """The hidden states one row later, in `count` steps."""
        if count not in self._advances:
            self._advances[count] = advance(self._model, partial(_hidden_slope, self._model), count)
        return self._advances[count]


_functions: dict[Hashable, _Functions] = {}


def _functions_of(model: Model, free: tuple[str, ...]) -> _Functions:
    """Functions of a model, kept for models of its structure."""
    if (model.structure, free) not in _functions:
        if len(_functions) >= MAX_KEPT:
            _functions.clear()
        _functions[model.structure, free] = _Functions(model, free)
    return _functions[model.structure, free]


def _hidden_slope_text(model: Model) -> tuple[str, list[int]]:
    """The hidden states' derivative, the same text in all models where it is the same, and its parameters' places."""
    if not model.hidden_count:
        return "", []
    row, h = ca.SX.sym("row", RIGID_BODY_STATES + model.input_count + 2), ca.SX.sym("h", model.hidden_count)
    p = ca.vertcat(*map(ca.SX.sym, model.parameter_names))
    slope = _hidden_slope(model, row, h, p)
    places = [place for place, is_in in enumerate(ca.which_depends(slope, p, 1, False)) if is_in]
    return ca.Function("slope", [row, h, p[places]], [slope]).serialize(), places


def _hidden_slope(model: Model, row: Expression, hidden: Expression, p: Expression) -> Expression:
    """(h,) derivative of the hidden states. row: measured state, rotors' speeds or commands, environment."""
    n = model.input_count
    rate, speed = _true(model, row[RATE], row[RIGID_BODY_STATES : RIGID_BODY_STATES + n], p)
    state = ca.vertcat(row[POSE_AND_VELOCITY], rate, hidden)
    return model.derivative(state, speed, p, row[RIGID_BODY_STATES + n :], ca.SX.zeros(model.hidden_count))[HIDDEN]


def _places(entries: slice) -> range:
    """Places of a hidden state, of which `entries` of the state are, among the hidden ones."""
    return range(entries.start - RIGID_BODY_STATES, entries.stop - RIGID_BODY_STATES)


def _symbols(model: Model) -> dict[str, Expression]:
    n = model.input_count
    sizes = {
        "x": model.state_count,
        "gyro": 3,
        "speed": n,
        "acceleration": n,
        "p": len(model.parameter_names),
        "e": 2,
        "angular": 3,
    }
    return {name: ca.SX.sym(name, size) for name, size in sizes.items()}


def _ages(model: Model, p: Expression) -> Expression:
    """(3,) age of the pose, of the attitude beyond it, and of the rotors' speeds, s."""
    nothing = ca.SX.zeros(3)
    read = model.measure(nothing, nothing, ca.SX.zeros(model.input_count), p, nothing)
    return ca.vertcat(read[3], read[4], read[7])


def _true(model: Model, rate: Expression, speed: Expression, p: Expression) -> tuple[Expression, Expression]:
    """Body rate and rotor speeds from their readings, which are affine in them, the rate behind a turn of the gyro."""
    nothing, true_speed = ca.SX.zeros(3), ca.SX.sym("true_speed", model.input_count)
    _, offset, speed_read, _, _, _, axes, _ = model.measure(nothing, nothing, true_speed, p, nothing)
    still = ca.substitute(speed_read, true_speed, ca.SX.zeros(true_speed.shape))
    true_rate = _solved(_gyro_gain(model, p), quaternion.rotate(axes, rate) - offset)
    return true_rate, _solved(ca.jacobian(speed_read, true_speed), speed - still)


def _true_acceleration(model: Model, measured: Expression, p: Expression) -> Expression:
    """(3,) angular acceleration from the gyro's derivative, which has the gyro's scale and axes."""
    axes = model.measure(*(ca.SX.zeros(n) for n in (3, 3, model.input_count)), p, ca.SX.zeros(3))[6]
    return _solved(_gyro_gain(model, p), quaternion.rotate(axes, measured))


def _gyro_gain(model: Model, p: Expression) -> Expression:
    """(3, 3) slope of the measured body rate in the true one, in the body's axes."""
    rate, nothing = ca.SX.sym("true_rate", 3), ca.SX.zeros(3)
    read = model.measure(nothing, rate, ca.SX.zeros(model.input_count), p, nothing)[1]
    return ca.jacobian(read, rate)


def _solved(slope: Expression, reading: Expression) -> Expression:
    """Solution of slope @ x = reading."""
    return reading / ca.diag(slope) if slope.sparsity().is_diag() else ca.solve(slope, reading)


def _outputs(model: Model, s: Mapping[str, Expression]) -> Expression:
    """Specific force as read, angular acceleration, true body rate, specific force that the pose shows: (12,).

    The lever arms of accelerometer and pose act through the measured angular acceleration, which the model's errors
    in moment do not spoil. The arm's part of the air velocity is left out: 0.1 m/s for 5 cm at 2 rad/s.
    """
    p = s["p"]
    smooth_rate, speed = _true(model, s["x"][RATE], s["speed"], p)
    gyro, _ = _true(model, s["gyro"], s["speed"], p)
    turning = _true_acceleration(model, s["angular"], p)
    *_, attitude_age, arm, gyro_axes, _ = model.measure(ca.SX.zeros(3), smooth_rate, speed, p, turning)
    late = quaternion.small_turn(attitude_age * smooth_rate)
    attitude = quaternion.multiply(s["x"][ATTITUDE], late)
    state = ca.vertcat(s["x"][: ATTITUDE.start], attitude, smooth_rate, s["x"][HIDDEN])
    force, angular = model.respond(state, speed, s["acceleration"], p, s["e"])
    read = model.measure(force, smooth_rate, speed, p, turning)[0]
    at_pose = force + lever_arm_acceleration(arm, smooth_rate, turning)
    of_gyro = quaternion.rotate_inverse(gyro_axes, _gyro_gain(model, p) @ angular)
    return ca.vertcat(read, of_gyro, gyro, quaternion.rotate(late, at_pose))
