"""Checks of a user's own effects: one Python file with an `EFFECT` in it, or several as `EFFECTS`."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from dynamics import symbolic
from dynamics.effect import Effect, Span
from dynamics.effect_source import EXAMPLE, EffectFile
from dynamics.effects import CATALOGUE
from dynamics.errors import RequestError
from dynamics.model import ENVIRONMENT_DEFAULT, build_model
from dynamics.own_effects import effects_of, line_of
from dynamics.state import RIGID_BODY_STATES
from dynamics.vehicle import EffectUse, Vehicle

ROOM = Span((-5.0, -5.0, 0.0), (5.0, 5.0, 3.0))  # m, for which an effect's grid is evaluated


def with_effects_of(files: Iterable[EffectFile], vehicle: Vehicle) -> Mapping[str, Effect]:
    """The catalogue and the effects of further files, each tried on the vehicle once.

    Raises RequestError for a file that is not approved or defines none, a name that is taken, or an effect that fails
    on the vehicle.
    """
    catalogue = dict(CATALOGUE)
    own: list[tuple[EffectFile, Effect]] = []
    for file in files:
        for effect in effects_of(file):
            if effect.name in catalogue:
                raise RequestError(f"{file.path}: there is an effect {effect.name!r} already; give yours another name.")
            if symbolic.is_installed():  # elsewhere only bundles fly, whose effects were tried at their export
                _try(effect, vehicle, file)
            catalogue[effect.name] = effect
            own.append((file, effect))
    for file, effect in own:
        for name in set(effect.confounded_with) - set(catalogue):
            raise RequestError(
                f"{file.path}: effect {effect.name!r}: confounded_with names {name!r}, which is no effect."
            )
    return catalogue


def _try(effect: Effect, vehicle: Vehicle, file: EffectFile) -> None:
    """Evaluate an effect in hover at its usual values. Raises RequestError when it fails or contradicts itself."""
    use = EffectUse(effect.name, {}, 0 if effect.per_rotor else None)
    with _refusing(effect, file):
        problem = next(_problems_on(effect, vehicle), None)
    if problem is not None:
        raise RequestError(f"{file.path}{problem}")
    with _refusing(effect, file):
        model = build_model(vehicle, effects=[use], catalogue={effect.name: effect})
        state = model.initial_state(_hover())
        values = model.observe(state, vehicle.hover_speed, model.parameter_values, ENVIRONMENT_DEFAULT)
        rates = model.derivative(state, vehicle.hover_speed, model.parameter_values, ENVIRONMENT_DEFAULT, 0)
    for value in (*values, rates):
        if not value.is_regular():
            raise RequestError(
                f"{file.path}: effect {effect.name!r} gives a force that is no number in hover: {value}."
            )


@contextmanager
def _refusing(effect: Effect, file: EffectFile) -> Iterator[None]:
    """Whatever a user's functions raise becomes a RequestError with the line."""
    try:
        yield
    except Exception as error:
        line = line_of(error, file)
        where = f"{file.path}, line {line}" if line else file.path
        raise RequestError(f"{where}: effect {effect.name!r} fails in hover: {type(error).__name__}: {error}") from None


def _problems_on(effect: Effect, vehicle: Vehicle) -> Iterator[str]:
    """Values of an effect that are impossible on a vehicle: the line and a sentence each."""
    bounds = {parameter.name: (parameter.lower, parameter.upper) for parameter in effect.parameters}
    for parameter in effect.parameters:
        prior = parameter.prior(vehicle)
        if not (math.isfinite(prior.mean) and math.isfinite(prior.std) and prior.std > 0):
            yield _at(parameter.prior, effect, f"the prior of {parameter.name} is {prior}")
    for hidden in effect.hidden:
        if not math.isfinite(hidden.initial(vehicle)):
            yield _at(hidden.initial, effect, f"the initial value of {hidden.name} is {hidden.initial(vehicle)}")
    if effect.grid is None:
        return
    for values in effect.grid(vehicle, ROOM):
        for name, value in values.items():
            if name not in bounds:
                yield _at(effect.grid, effect, f"the grid names {name!r}, not one of {', '.join(bounds)}")
            elif not bounds[name][0] <= value <= bounds[name][1]:
                yield _at(effect.grid, effect, f"the grid holds {name} = {value}, outside {list(bounds[name])}")


def _at(function: Callable[..., Any], effect: Effect, sentence: str) -> str:
    code = getattr(function, "__code__", None)
    line = f", line {code.co_firstlineno}" if code is not None else ""
    return f"{line}: effect {effect.name!r}: {sentence}. {EXAMPLE}"


def _hover() -> Any:
    state = [0.0] * RIGID_BODY_STATES
    state[2], state[6] = 1.0, 1.0
    return state
