"""What an effect cannot be: fields that contradict each other."""

from __future__ import annotations

from collections.abc import Iterator
from string import Formatter
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from dynamics.effect import Effect

ACTS_ON = ("motion", "command_gain", "rotor_speed_reading")


def contradictions(effect: Effect) -> Iterator[str]:
    """What cannot be true of an effect, one sentence each."""
    names = [parameter.name for parameter in effect.parameters]
    states = [hidden.name for hidden in effect.hidden]
    hooks = (effect.physics, effect.rotor_speed, effect.wind, effect.wrench, effect.measurement)
    if not effect.name.isidentifier():
        yield "a name is letters, digits and underscores"
    if not names:
        yield "it has no parameter, so nothing of it could be fitted"
    if all(hook is None for hook in hooks):
        yield "it has none of physics, rotor_speed, wind, wrench and measurement, so it does nothing"
    for kind, listed in (("parameter", names), ("hidden state", states)):
        for name in {name for name in listed if listed.count(name) > 1}:
            yield f"two {kind}s are called {name!r}"
    for parameter in effect.parameters:
        if not parameter.lower < parameter.upper:
            yield f"{parameter.name}: lower {parameter.lower} is not below upper {parameter.upper}"
    if bool(states) != (effect.derivative is not None):
        yield "hidden states need a derivative, and a derivative hidden states"
    if effect.rotor_speed is not None and effect.rotor_speed_state is None:
        yield "rotor_speed needs a hidden state of each rotor (per_rotor=True) that holds the speed"
    for field in ("refine", "time_constants"):
        for name in set(getattr(effect, field)) - set(names):
            yield f"{field} names {name!r}, which is none of its parameters ({', '.join(names)})"
    yield from _contradicting_roles(effect)


def _contradicting_roles(effect: Effect) -> Iterator[str]:
    """What cannot be true of the fields that steer diagnosis and integration."""
    for parameter in effect.parameters:
        if parameter.name in effect.time_constants and not parameter.lower > 0:
            yield f"time constant {parameter.name} has the lower bound {parameter.lower} s; it must be above 0"
    if effect.time_constants and not effect.hidden:
        yield "time_constants belong to hidden states, and it has none"
    if effect.grid is None and (effect.refine or effect.min_detectable):
        yield "refine and min_detectable belong to a grid, and it has none"
    if effect.stochastic and not effect.hidden:
        yield "stochastic effects have hidden states that noise drives, and it has none"
    if effect.stochastic and effect.grid is not None:
        yield "a stochastic effect is not regressed, so it needs no grid"
    if effect.sensor_prior is not None and (effect.measurement is None or not effect.sensor_prior > 0):
        yield "sensor_prior is a standard deviation above 0 of a fault of a sensor (measurement)"
    if effect.acts_on not in ACTS_ON:
        yield f"acts_on is {effect.acts_on!r}, not one of {', '.join(ACTS_ON)}"
    if effect.acts_on == "rotor_speed_reading" and effect.measurement is None:
        yield 'acts_on="rotor_speed_reading" needs a measurement'
    if effect.acts_on == "command_gain" and effect.physics is None:
        yield 'acts_on="command_gain" needs physics'
    if effect.name in effect.confounded_with:
        yield "confounded_with names the effect itself"
    placeholders = {name for _, name, _, _ in Formatter().parse(effect.caveat) if name is not None}
    for name in placeholders - {parameter.name for parameter in effect.parameters}:
        yield f"caveat names {{{name}}}, which is none of its parameters"
