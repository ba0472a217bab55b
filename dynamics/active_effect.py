"""Effects in a model: their values in the parameter vector, their hidden states behind the rigid body's."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from dynamics import symbolic as ca
from dynamics.arrays import Floats
from dynamics.effect import Effect, Environment, Expression, Physics, Values
from dynamics.errors import RequestError
from dynamics.state import RIGID_BODY_STATES
from dynamics.vehicle import EffectUse, Vehicle


@dataclass(frozen=True)
class ActiveEffect:
    """An effect in a model.

    key: its name there, such as "rotor_drag" or "weak_rotor[2]".
    rotor: the rotor on which it acts, None for an effect of the whole vehicle.
    values: of its parameters.
    hidden: places of its hidden states in the state.
    """

    effect: Effect
    key: str
    rotor: int | None
    values: Mapping[str, float]
    hidden: Mapping[str, slice]

    def parameters(self, p: Values) -> Values:
        """Its parameters among the model's, by its own names."""
        return {name: p[f"{self.key}.{name}"] for name in self.values}

    def states(self, x: Expression) -> Values:
        """Its hidden states in the state."""
        return {name: x[place] for name, place in self.hidden.items()}

    def noise(self, w: Expression) -> Values:
        """The white noise on its hidden states."""
        start = RIGID_BODY_STATES
        return {name: w[place.start - start : place.stop - start] for name, place in self.hidden.items()}


def activate(
    vehicle: Vehicle, uses: Sequence[EffectUse], catalogue: Mapping[str, Effect]
) -> tuple[tuple[ActiveEffect, ...], Floats]:
    """The effects of a model, and its hidden states in hover. Raises RequestError when an effect is given twice."""
    active: list[ActiveEffect] = []
    initial: list[float] = []
    for use in uses:
        effect = catalogue[use.name]
        places = {}
        for hidden in effect.hidden:
            count = vehicle.rotors.count if hidden.per_rotor else 1
            start = RIGID_BODY_STATES + len(initial)
            places[hidden.name] = slice(start, start + count)
            initial += [hidden.initial(vehicle)] * count
        key = use.label
        if any(item.key == key for item in active):
            raise RequestError(f"effect {key} is given twice; give it once, with the values that it has in all.")
        values = {**effect.defaults(vehicle), **use.parameters}
        active.append(ActiveEffect(effect, key, use.rotor, values, places))
    return tuple(active), np.array(initial, dtype=float)


def time_constants(active: Sequence[ActiveEffect]) -> tuple[float, ...]:
    """Values of the effects' time constants, s."""
    return tuple(item.values[name] for item in active for name in item.effect.time_constants)


def model_parameters(vehicle: Vehicle, active: Sequence[ActiveEffect]) -> dict[str, float]:
    """Every physical constant by its name in the parameter vector, in order: body, rotors, effects."""
    body, rotors = vehicle.body, vehicle.rotors
    named: dict[str, float] = {"body.mass": body.mass}
    for axis, moment, offset in zip("xyz", body.inertia, body.centre_of_mass, strict=True):
        named[f"body.inertia_{axis}"] = moment
        named[f"body.centre_of_mass_{axis}"] = offset
    for i, (position, spin) in enumerate(zip(rotors.position, rotors.spin, strict=True)):
        named |= {f"rotors.position_{axis}[{i}]": value for axis, value in zip("xyz", position, strict=True)}
        named[f"rotors.spin[{i}]"] = float(spin)
    named["rotors.thrust_constant"] = rotors.thrust_constant
    named["rotors.torque_constant"] = rotors.torque_constant
    named["rotors.radius"] = rotors.disc_radius
    for item in active:
        named |= {f"{item.key}.{name}": value for name, value in item.values.items()}
    return named


def changed_physics(count: int, active: Sequence[ActiveEffect], p: Values, environment: Environment) -> Physics:
    """The vehicle file's constants as the effects change them. count: rotors."""

    def vector(name: str) -> Expression:
        return ca.vertcat(*[p[f"{name}_{axis}"] for axis in "xyz"])

    position = [ca.vertcat(*[p[f"rotors.position_{axis}[{i}]"] for axis in "xyz"]) for i in range(count)]
    physics = Physics(
        mass=p["body.mass"],
        inertia=vector("body.inertia"),
        centre_of_mass=vector("body.centre_of_mass"),
        rotor_position=ca.horzcat(*position),
        spin=ca.vertcat(*[p[f"rotors.spin[{i}]"] for i in range(count)]),
        thrust_constant=ca.repmat(p["rotors.thrust_constant"], count, 1),
        torque_constant=ca.repmat(p["rotors.torque_constant"], count, 1),
        rotor_radius=p["rotors.radius"],
    )
    for item in active:
        if item.effect.physics is not None:
            physics = item.effect.physics(physics, item.parameters(p), environment, item.rotor)
    return physics
