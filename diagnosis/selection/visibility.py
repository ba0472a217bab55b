"""Which effects a log could show at all: an effect that depends on what was not logged is no candidate."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import casadi as ca

from diagnosis.data.segment import Segment
from dynamics.effect import Effect
from dynamics.model import Model, build_model
from dynamics.state import ATTITUDE, POSITION, RIGID_BODY_STATES, VELOCITY
from dynamics.vehicle import EffectUse, Vehicle

STATE_ROWS = {"position": POSITION, "velocity": VELOCITY, "attitude": ATTITUDE}
FORCE_READING, RATE_READING, POSE_AGE, ATTITUDE_AGE, POSE_ARM, GYRO_AXES = (
    0,
    1,
    3,
    4,
    5,
    6,
)  # places among the outputs of a model's `measure`
PARAMETERS = 3  # place among its inputs
ENVIRONMENT, BATTERY = 3, 1  # place among the inputs of `observe` and `derivative`, and of the voltage in it


def can_show(effect: Effect, segments: Sequence[Segment], vehicle: Vehicle, catalogue: Mapping[str, Effect]) -> bool:
    """Whether the segments hold the signals that the effect acts on."""
    source = segments[0].rotor_source
    if effect.rotor_speed is not None:
        return source != "measured"  # between command and speed, which does not matter where speed is measured
    if effect.acts_on in ("rotor_speed_reading", "rotor_clock"):
        return source == "measured"
    if effect.acts_on == "command_gain" and source == "command":
        return False  # where only commands were logged their gain is an unknown of its own, which is this
    if effect.acts_on == "weight" and source == "command" and not _has_drag(segments, vehicle, catalogue):
        return False  # thrust carries the weight, and what is left of a mass is what inertia does
    if any(s.battery_ratio is None for s in segments) and needs_battery(effect, vehicle, catalogue):
        return False
    if any(s.pose_source == "estimator" for s in segments) and _turns_or_scales(effect, vehicle, catalogue):
        return False  # an estimator's pose is that of the sensors, with their axes and scale
    if any(s.gyro is None for s in segments) and _is_of_gyro(effect, vehicle, catalogue):
        return False  # the rates are the attitude's, which a gyro that was not logged cannot spoil
    lacks = frozenset[str]().union(*(s.lacks for s in segments))
    return not lacks or not lacks & state_dependencies(effect, vehicle, catalogue)


def _is_of_gyro(effect: Effect, vehicle: Vehicle, catalogue: Mapping[str, Effect]) -> bool:
    """Whether an effect is a fault of the gyro and of nothing else."""
    measure = _alone(effect, vehicle, catalogue).measure
    moved = {place for place in range(measure.n_out()) if measure.jac_sparsity(place, PARAMETERS).nnz()}
    return bool(moved) and moved <= {RATE_READING, GYRO_AXES}


def _turns_or_scales(effect: Effect, vehicle: Vehicle, catalogue: Mapping[str, Effect]) -> bool:
    """Whether an effect turns the axes of the inertial sensors against the body, or changes their scale."""
    measure = _alone(effect, vehicle, catalogue).measure
    turns = measure.jac_sparsity(GYRO_AXES, PARAMETERS).nnz() > 0
    return not effect.moves_vehicle and (turns or bool(_scaled(effect, measure)))


def _scaled(effect: Effect, measure: ca.Function) -> set[int]:
    """Places of the inertial sensors' readings of which parameters change the scale, axis by axis.

    None for a fault with a sensor prior, which bounds it where nothing else shows it.
    """
    if effect.sensor_prior is not None:
        return set()
    symbols = [ca.SX.sym(name, measure.size1_in(i)) for i, name in enumerate(measure.name_in())]
    read = measure(*symbols)
    slopes = {place: ca.jacobian(read[place], symbols[place]) for place in (FORCE_READING, RATE_READING)}
    return {
        place
        for place, slope in slopes.items()
        if slope.sparsity().is_diag() and ca.depends_on(slope, symbols[PARAMETERS])
    }


def _has_drag(segments: Sequence[Segment], vehicle: Vehicle, catalogue: Mapping[str, Effect]) -> bool:
    """Whether the vehicle file has a drag, and the segments a pose that shows it."""
    return all(s.has_pose for s in segments) and any(catalogue[use.name].resists_air for use in vehicle.effects)


def state_dependencies(effect: Effect, vehicle: Vehicle, catalogue: Mapping[str, Effect]) -> frozenset[str]:
    """Which of position, velocity and attitude an effect needs: by the structure of its own expressions."""
    model = _alone(effect, vehicle, catalogue)
    columns = _state_columns(model)
    quantities = {name for name, rows in STATE_ROWS.items() if columns & set(range(rows.start, rows.stop))}
    if effect.moves_vehicle:
        return frozenset(quantities)

    def depends(*outputs: int) -> bool:
        return any(model.measure.jac_sparsity(output, PARAMETERS).nnz() for output in outputs)

    if depends(RATE_READING, POSE_AGE, ATTITUDE_AGE):
        quantities.add("attitude")  # a fault of the gyro or of the pose's clock shows against the attitude
    if depends(POSE_ARM) or FORCE_READING in _scaled(effect, model.measure):
        quantities |= {"velocity", "attitude"}  # without a pose a scale of the accelerometer looks like thrust
    return frozenset(quantities)


def needs_battery(effect: Effect, vehicle: Vehicle, catalogue: Mapping[str, Effect]) -> bool:
    """Whether forces, torques or hidden states of an effect depend on the battery's voltage."""
    model = _alone(effect, vehicle, catalogue)
    slopes = [model.observe.jac_sparsity(output, ENVIRONMENT) for output in range(2)]
    slopes.append(model.derivative.jac_sparsity(0, ENVIRONMENT))
    return any(BATTERY in slope.get_triplet()[1] for slope in slopes)


def _alone(effect: Effect, vehicle: Vehicle, catalogue: Mapping[str, Effect]) -> Model:
    use = EffectUse(effect.name, {}, 0 if effect.per_rotor else None)
    return build_model(vehicle, effects=[use], catalogue=catalogue)


def _state_columns(model: Model) -> set[int]:
    """The entries of the state that forces, torques and hidden states depend on."""
    entries: set[int] = set()
    for output in range(2):  # specific force and angular acceleration
        entries |= set(model.observe.jac_sparsity(output, 0).get_triplet()[1])
    hidden: ca.Sparsity = model.derivative.jac_sparsity(0, 0)
    rows, columns = hidden.get_triplet()
    entries |= {column for row, column in zip(rows, columns, strict=True) if row >= RIGID_BODY_STATES}
    return entries
