"""A model as its compiled kernel needs it: numbers alone, which a bundle stores, so that it flies without CasADi."""

from __future__ import annotations

from dataclasses import dataclass

import msgspec
import numpy as np

from dynamics.active_effect import activate, model_parameters
from dynamics.arrays import Floats
from dynamics.model import Model
from dynamics.state_shape import StateShape
from dynamics.trim import Trim, find_trim, trim_at, trim_without_effects
from dynamics.vehicle import Vehicle


class Hover(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The hover of a model with effects: mass, kg, and thrust constant, N s^2/rad^2, of a vehicle without them.

    rotor_speed: rad/s.
    """

    mass: float
    thrust_constant: float
    rotor_speed: tuple[float, ...]


class KernelFacts(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Constants derived from the model at export time, so that flight needs no CasADi.

    parameters: p.
    hidden_initial: hidden states in hover.
    thrust_constants: of each rotor with the effects on it, N s^2/rad^2.
    hover: None for a model without effects.
    rotor_speed_starts: where a state begins to hold the rotors' real speeds, one for each lag of the model.
    """

    parameters: tuple[float, ...]
    hidden_initial: tuple[float, ...]
    thrust_constants: tuple[float, ...]
    hover: Hover | None = None
    rotor_speed_starts: tuple[int, ...] = ()


@dataclass(frozen=True, eq=False)
class KernelModel(StateShape):
    """A model without its formulas; names and shapes are those of `dynamics.model.Model`."""

    vehicle: Vehicle
    parameter_values: Floats
    hidden_initial: Floats
    thrust_constants: Floats
    trim: Trim
    rotor_speed_places: tuple[slice, ...] = ()

    @classmethod
    def of(cls, vehicle: Vehicle, facts: KernelFacts) -> KernelModel:
        """The model of a vehicle, whose body, rotors and effects are those that the facts were found for."""
        hover = facts.hover
        trim = (
            trim_without_effects(vehicle)
            if hover is None
            else trim_at(vehicle, hover.mass, hover.thrust_constant, np.array(hover.rotor_speed))
        )
        parameters, hidden, thrust = map(np.array, (facts.parameters, facts.hidden_initial, facts.thrust_constants))
        places = tuple(slice(start, start + vehicle.rotors.count) for start in facts.rotor_speed_starts)
        return cls(vehicle, parameters, hidden.astype(float), thrust, trim, places)


FlownModel = Model | KernelModel


def kernel_facts(model: Model) -> KernelFacts:
    """The numbers of a model; needs CasADi."""
    hover = None
    if model.effects:
        trim = find_trim(model)
        body, rotors = trim.vehicle.body, trim.vehicle.rotors
        hover = Hover(body.mass, rotors.thrust_constant, tuple(trim.rotor_speed.tolist()))
    return KernelFacts(
        parameters=tuple(model.parameter_values.tolist()),
        hidden_initial=tuple(model.hidden_initial.tolist()),
        thrust_constants=tuple(model.thrust_constants.tolist()),
        hover=hover,
        rotor_speed_starts=tuple(place.start for place in model.rotor_speed_places),
    )


def nominal_kernel_model(vehicle: Vehicle) -> KernelModel:
    """The model of a vehicle without effects, which needs no formula."""
    active, _ = activate(vehicle, (), {})
    parameters = tuple(model_parameters(vehicle, active).values())
    return KernelModel.of(
        vehicle, KernelFacts(parameters, (), (vehicle.rotors.thrust_constant,) * vehicle.rotors.count)
    )


def trim_of(model: FlownModel) -> Trim:
    """The hover of a model."""
    return model.trim if isinstance(model, KernelModel) else find_trim(model)
