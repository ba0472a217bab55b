"""Effects between a motor command and thrust, which every model of a command log holds.

A thrust command in newtons is not thrust (0.63 to 1.7 times of it in one set of real flights), a signal of 0 to 1 has a
curve that vehicle files describe badly, both change with the battery, and motors differ by a tenth. None of it is a
property that the user asks for: these effects are fitted beside all others, with priors, and are never named.

The gain is that of thrust over weight, which every flight shows well: whatever mass a model has, its thrust carries it.
A wrong mass then shows where it differs from a wrong gain: in drag over mass and in moment over inertia.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import casadi as ca
import msgspec

from diagnosis.data.segment import Segment
from diagnosis.thresholds import CommandCurveThresholds
from dynamics.effect import Conditions, Effect, Environment, Parameter, Physics, Prior, Values, Wrench
from dynamics.effects.mass import EFFECT as MASS
from dynamics.effects.thrust_constant import EFFECT as THRUST_CONSTANT
from dynamics.effects.torque_constant import EFFECT as TORQUE_CONSTANT
from dynamics.vehicle import GRAVITY, EffectUse, Vehicle


def scaled_rotors(body: Physics, p: Values, _: Environment, rotor: int | None) -> Physics:
    """k_f and k_tau of all rotors times ratio; or those of one, while the others keep the sum."""
    share = ca.SX.ones(body.rotor_count)
    if rotor is None:
        share = share * p["ratio"]
    else:
        share = share - (p["ratio"] - 1) / (body.rotor_count - 1)
        share[rotor] = p["ratio"]
    return replace(body, thrust_constant=body.thrust_constant * share, torque_constant=body.torque_constant * share)


def bent_thrust(c: Conditions, p: Values, _: Values) -> Wrench:
    """Each rotor's thrust and torque times 1 + bend (T / T_0 - 1), with T_0 its share of the weight."""
    physics = c.physics
    share = c.rotor_thrust * physics.rotor_count / (physics.mass * GRAVITY) - 1
    thrust = p["bend"] * share * c.rotor_thrust
    torque = thrust * physics.torque_constant / physics.thrust_constant
    r = c.rotor_position
    moment = ca.vertcat(ca.dot(r[1, :].T, thrust), -ca.dot(r[0, :].T, thrust), ca.dot(physics.spin, torque))
    return Wrench(ca.vertcat(0, 0, ca.sum1(thrust)), moment)


GAIN = Effect(
    name="command_gain",
    summary="Thrust and torque of all rotors over those that the vehicle file gives for their commands",
    source="definition",
    parameters=(
        Parameter("ratio", "1", "real thrust over the file's", 0.3, 3.0, lambda _: Prior(1.0, 0.3), neutral=1.0),
    ),
    physics=scaled_rotors,
)
MOTOR = Effect(
    name="motor_gain",
    summary="Thrust and torque of one rotor over the mean at the same command",
    source="definition",
    parameters=(Parameter("ratio", "1", "its thrust over the mean", 0.4, 1.6, lambda _: Prior(1.0, 0.1), neutral=1.0),),
    physics=scaled_rotors,
    per_rotor=True,
)
BEND = Effect(
    name="command_bend",
    summary="Thrust over command bends away from the curve of the vehicle file",
    source="first two terms of a Taylor series about hover",
    parameters=(Parameter("bend", "1", "", -1.0, 1.0, lambda _: Prior(0.0, 0.3)),),
    wrench=bent_thrust,
)
COMMAND_EFFECTS: Mapping[str, Effect] = {effect.name: effect for effect in (GAIN, MOTOR, BEND)}
AS_GAIN = (THRUST_CONSTANT.name, MASS.name)  # of which the thrust shows nothing but a gain
BESIDE_THE_GAIN: Mapping[str, str] = {THRUST_CONSTANT.name: TORQUE_CONSTANT.name}


def seen_as(names: Collection[str], catalogue: Mapping[str, Effect]) -> list[str]:
    """Effects of a catalogue of which no more can be seen beside the free gain than one of these effects.

    With less thrust at a command the gain is greater, and the torque with it.
    """
    return [name for name, other in BESIDE_THE_GAIN.items() if other in names and name in catalogue]


def _carried(reference: float) -> Effect:
    """The effect of a mass that the thrust carries. reference: mass ratio for which commands became rotor speeds."""

    def physics(body: Physics, p: Values, environment: Environment, rotor: int | None) -> Physics:
        share = p["ratio"] / reference
        thrust, torque = body.thrust_constant * share, body.torque_constant * share
        return replace(body, mass=body.mass * p["ratio"], thrust_constant=thrust, torque_constant=torque)

    return replace(MASS, physics=physics)


def with_command_effects(
    vehicle: Vehicle, catalogue: Mapping[str, Effect], segments: Sequence[Segment]
) -> tuple[Vehicle, Mapping[str, Effect]]:
    """Vehicle and catalogue with what lies between command and thrust, the same where rotor speeds were measured."""
    if segments[0].rotor_source != "command":
        return vehicle, catalogue
    catalogue = {**catalogue, **COMMAND_EFFECTS}
    if catalogue.get(MASS.name) is MASS:
        catalogue[MASS.name] = _carried(segments[0].carried_mass)
    if any(use.name in COMMAND_EFFECTS for use in vehicle.effects):
        return vehicle, catalogue
    uses = [EffectUse(GAIN.name, {"ratio": 1.0}), EffectUse(BEND.name, {"bend": 0.0})]
    uses += [EffectUse(MOTOR.name, {"ratio": 1.0}, rotor) for rotor in range(vehicle.rotors.count)]
    return vehicle.with_effects(*uses), catalogue


def without_command_effects(vehicle: Vehicle) -> Vehicle:
    """The vehicle as its file may hold it."""
    uses = tuple(use for use in vehicle.effects if use.name not in COMMAND_EFFECTS)
    return vehicle if len(uses) == len(vehicle.effects) else msgspec.structs.replace(vehicle, effects=uses)


def flight_deviations(thresholds: CommandCurveThresholds) -> Mapping[str, float]:
    """Standard deviations of what each flight has of its own, about what all flights share, by effect."""
    return {GAIN.name: thresholds.flight_gain_std, MOTOR.name: thresholds.flight_motor_std}


def own_gains(vehicle: Vehicle, thresholds: CommandCurveThresholds) -> dict[str, float]:
    """Of a vehicle with such effects the parameters of which each flight has a deviation, and the latter's spread."""
    own = flight_deviations(thresholds)
    return {f"{use.label}.ratio": own[use.name] for use in vehicle.effects if use.name in own}


def prior_deviation(effect: Effect, thresholds: CommandCurveThresholds) -> float:
    """Standard deviation of the one parameter of a command effect."""
    return {GAIN.name: thresholds.gain_std, MOTOR.name: thresholds.motor_std, BEND.name: thresholds.bend_std}[
        effect.name
    ]
