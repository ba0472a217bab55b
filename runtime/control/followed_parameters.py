"""Parameters of effects that are estimated in flight: which of a model's, with the effects' own bounds and priors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from dynamics.active_effect import activate, model_parameters
from dynamics.effect import Effect
from dynamics.effects import CATALOGUE, wind
from dynamics.errors import RequestError
from dynamics.own_effects import catalogue_of
from dynamics.vehicle import EffectUse, Vehicle
from runtime.control.kernel_model import FlownModel

Group = Literal["other", "drag", "air", "thrust", "moment", "voltage"]


@dataclass(frozen=True)
class FollowedParameter:
    """A parameter that is followed in flight.

    name: as in the model's parameter vector, such as "wind.x".
    index: its place there.
    value, std: its prior.
    lower, upper: its bounds.
    group: "drag" shows where its slope varies, whose constant part depends on the wind; "air", the wind, beside a drag
        that is certain; "thrust" never, since the effectiveness of thrust has it; "moment" by the real speeds of rotors
        (`MomentFit`); "voltage" by the effectiveness of thrust (`SagFit`); "other" always.
    unit: SI.
    """

    name: str
    index: int
    value: float
    std: float
    lower: float
    upper: float
    group: Group = "other"
    unit: str = ""


def with_followed(vehicle: Vehicle, names: Sequence[str], catalogue: Mapping[str, Effect] = CATALOGUE) -> Vehicle:
    """The vehicle with those of the effects that it lacks, each as if it were not there.

    Raises RequestError for an effect that is not in the catalogue, of one rotor, or that noise drives.
    """
    offered = catalogue_of(vehicle, catalogue)
    there = {use.name for use in vehicle.effects}
    for name in names:
        effect = offered.get(name)
        if effect is None or effect.per_rotor or effect.stochastic or not effect.moves_vehicle:
            what = "not in the catalogue" if effect is None else "of one rotor, of a sensor or random"
            raise RequestError(f"{name} cannot be followed in flight: it is {what}. `alula effects` lists all effects.")
    neutral = (
        EffectUse(name, {p.name: p.neutral for p in offered[name].parameters}) for name in names if name not in there
    )
    return vehicle.with_effects(*neutral)


def followed_parameters(
    model: FlownModel, names: Sequence[str], *, prior_scale: float = 1.0, drag_share: float = float("inf")
) -> list[FollowedParameter]:
    """The parameters of those effects that are in a model. The bounds and priors are the effects' own.

    prior_scale: of the priors' standard deviations.
    drag_share: standard deviation of a drag that the model has already, as a share of it, if that is less.
    """
    active, _ = activate(model.vehicle, model.vehicle.effects, catalogue_of(model.vehicle))
    places = list(model_parameters(model.vehicle, active))
    has_drag = any(item.effect.resists_air for item in active)
    followed = []
    for item in active:
        group: Group = "drag" if item.effect.resists_air else "other"
        if item.effect.wind is not None and has_drag:
            group = "air"
        if item.effect.acts_on in ("weight", "command_gain") or item.effect.voltage_power:
            group = "thrust"
        for parameter in item.effect.parameters if item.effect.name in names else ():
            if item.effect.wind is not None and parameter.name == wind.COEFFICIENT.name:
                continue  # acts without a drag alone, where only its product with the wind would show
            name, std = f"{item.key}.{parameter.name}", prior_scale * parameter.prior(model.vehicle).std
            bounds = parameter.lower, parameter.upper
            value = item.values[parameter.name]
            if group == "drag" and value != parameter.neutral:
                std = min(std, drag_share * abs(value - parameter.neutral))
            place = places.index(name)
            own: Group = "voltage" if parameter.name == item.effect.voltage_power else group
            followed.append(FollowedParameter(name, place, value, std, *bounds, own, parameter.unit))
    return followed


def has_known_drag(model: FlownModel, names: Sequence[str]) -> bool:
    """Whether a model has drags and none is among those effects: they keep their values, and show the wind.

    Beside a drag that is followed another one does not count: on PX4's estimate, whose velocity errs slowly, a wind was
    named in 12 of 96 flights in still air.
    """
    active, _ = activate(model.vehicle, model.vehicle.effects, catalogue_of(model.vehicle))
    drags = [item.effect.name for item in active if item.effect.resists_air]
    return bool(drags) and not set(drags) & set(names)


def rotor_loss_effect(model: FlownModel) -> tuple[str, str] | None:
    """Effect and parameter that name the share of thrust that a rotor has lost; None where the catalogue has none."""
    offered = catalogue_of(model.vehicle)
    return next(((name, effect.lost_thrust) for name, effect in offered.items() if effect.lost_thrust), None)
