"""Parameters followed in recorded flights, beside the diagnosis of these flights: whether both agree, or why not."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import msgspec

from diagnosis.data.dataset import Dataset
from diagnosis.diagnose import DiagnosisDetails
from diagnosis.estimation.refusal import reason_of
from diagnosis.report import Diagnosis, FollowedEffect, FollowedParameter, InFlightOutcome
from diagnosis.thresholds import DEFAULT, InFlightThresholds
from dynamics.effect import Effect
from dynamics.errors import RequestError
from dynamics.vehicle import Vehicle
from dynamics.vehicle_file import parse_vehicle, with_texts
from flights.followed import FollowedFlight, FollowedValue, read_followed


class FollowedGroup(NamedTuple):
    """The followed parameters of one effect, by their own names."""

    key: str
    name: str
    rotor: int | None
    values: Mapping[str, FollowedValue]


def followed_groups(followed: FollowedFlight) -> list[FollowedGroup]:
    """The effects that a flight followed."""
    groups: dict[str, dict[str, FollowedValue]] = {}
    for full_name, value in followed.values.items():
        key, _, parameter = full_name.rpartition(".")
        groups.setdefault(key, {})[parameter] = value
    return [_group(key, values) for key, values in groups.items()]


def _group(key: str, values: Mapping[str, FollowedValue]) -> FollowedGroup:
    name, bracket, rotor = key.removesuffix("]").partition("[")
    return FollowedGroup(key, name, int(rotor) if bracket else None, values)


def with_in_flight(
    details: DiagnosisDetails, dataset: Dataset, catalogue: Mapping[str, Effect], vehicle: Vehicle
) -> DiagnosisDetails:
    """A diagnosis with what the models of its recordings followed; notes where that cannot be compared.

    vehicle: that was diagnosed.
    """
    effects: list[FollowedEffect] = []
    flights: list[FollowedFlight] = []
    notes = list(details.notes)
    for path in (*dataset.hashes, *dataset.held_hashes):
        followed = read_followed(path) if Path(path).is_file() else None
        if followed is None:
            continue
        try:
            different = constant_differences(flown_vehicle(followed, vehicle, catalogue), vehicle)
        except RequestError as error:
            different = [str(error)]
        if different:
            notes.append(f"not compared with what {path} followed, for its vehicle file is another: {different[0]}")
        else:
            effects += beside_diagnosis(followed, details, catalogue)
            flights.append(followed)
    diagnosis = msgspec.structs.replace(details.diagnosis, in_flight=tuple(effects))
    return dataclasses.replace(details, diagnosis=diagnosis, notes=tuple(notes), followed=tuple(flights))


def beside_diagnosis(
    followed: FollowedFlight,
    details: DiagnosisDetails,
    catalogue: Mapping[str, Effect],
    limits: InFlightThresholds = DEFAULT.in_flight,
) -> tuple[FollowedEffect, ...]:
    """Every effect that a flight followed, then those that are diagnosed and that it did not follow."""
    groups = followed_groups(followed)
    effects = [_compared(group, followed, details, catalogue, limits) for group in groups]
    identities = {(group.name, group.rotor) for group in groups}
    for effect in details.diagnosis.effects:
        if (effect.name, effect.rotor) not in identities:
            reason = "it was not among the effects that were followed" if groups else "no effect was followed by name"
            reason += "; what it does is in the disturbance" if catalogue[effect.name].moves_vehicle else ""
            identity = followed.path.name, effect.name, effect.rotor
            effects.append(FollowedEffect(*identity, "not_estimated", True, {}, reason))
    return tuple(effects)


def _compared(
    group: FollowedGroup,
    followed: FollowedFlight,
    details: DiagnosisDetails,
    catalogue: Mapping[str, Effect],
    limits: InFlightThresholds,
) -> FollowedEffect:
    effect = catalogue[group.name]
    estimates = details.accepted.fit.estimates
    model = _values_in(details.vehicle, group, effect)
    parameters = {}
    for parameter in effect.parameters:
        if (value := group.values.get(parameter.name)) is None:
            continue
        fitted = estimates.get((group.key, parameter.name))
        parameters[parameter.name] = FollowedParameter(
            value=value.value,
            std=value.std,
            unit=parameter.unit,
            shown=is_shown(value, limits),
            diagnosed=model[parameter.name],
            diagnosed_std=0.0 if fitted is None else fitted.std,
        )
    named = any((e.name, e.rotor) == (group.name, group.rotor) for e in details.diagnosis.effects)
    outcome, reason = _outcome(group, parameters, followed, details.diagnosis, catalogue, limits, named=named)
    return FollowedEffect(followed.path.name, group.name, group.rotor, outcome, named, parameters, reason)


def is_shown(value: FollowedValue, limits: InFlightThresholds = DEFAULT.in_flight) -> bool:
    """Whether a flight showed a parameter, and did not leave it at its prior."""
    return value.std <= limits.max_unshown * value.start_std


def _values_in(vehicle: Vehicle, group: FollowedGroup, effect: Effect) -> dict[str, float]:
    """Values of an effect in a vehicle's model, neutral ones where it lacks the effect."""
    use = next((u for u in vehicle.effects if (u.name, u.rotor) == (group.name, group.rotor)), None)
    if use is None:
        return {p.name: p.neutral for p in effect.parameters}
    return {**effect.defaults(vehicle), **use.parameters}


def _outcome(
    group: FollowedGroup,
    parameters: Mapping[str, FollowedParameter],
    followed: FollowedFlight,
    diagnosis: Diagnosis,
    catalogue: Mapping[str, Effect],
    limits: InFlightThresholds,
    *,
    named: bool,
) -> tuple[InFlightOutcome, str]:
    effect = catalogue[group.name]
    shown = {name: p for name, p in parameters.items() if p.shown}
    if not shown:
        return "not_estimated", "the flight did not show it, and its interval is still about that of before the flight"
    compared = {name: p for name, p in shown.items() if p.diagnosed_std or not named}  # not what it holds
    apart = {name: p for name, p in compared.items() if not _overlap(p, limits)}
    if not apart:
        return "agrees", ""
    reasons = [
        _distance(apart),
        *_changed(group, list(apart), followed, effect, limits),
        *in_effectiveness(followed, effect, limits),
        *(_why_named_otherwise if named else _why_not_named)(group, effect, diagnosis, catalogue),
    ]
    if followed.trust[followed.last, 0] < 1.0:
        reasons.append("in flight it forecast worse than the vehicle file's model, and was not flown at the end")
    if len(reasons) == 1:
        reasons.append("nothing in the recording shows which is right: compare on another flight")
    return "differs", "; ".join(reasons)


def _distance(apart: Mapping[str, FollowedParameter]) -> str:
    """Which parameter is farthest from its diagnosed value, in standard deviations of the difference."""
    deviations = {
        name: abs(p.value - p.diagnosed) / max(math.hypot(p.std, p.diagnosed_std), 1e-300) for name, p in apart.items()
    }
    name = max(deviations, key=lambda key: deviations[key])
    return f"{name} is {deviations[name]:.1f} standard deviations away"


def in_effectiveness(
    followed: FollowedFlight, effect: Effect, limits: InFlightThresholds = DEFAULT.in_flight
) -> Iterator[str]:
    """That what scales the thrust in flight is in its effectiveness, and what mass alone would look the same."""
    if effect.acts_on not in ("command_gain", "weight"):
        return
    last = followed.last
    value, reach = followed.effectiveness[last], limits.interval * followed.effectiveness_deviation[last]
    has_interval = math.isfinite(reach)
    text = f"in flight whatever acts like a gain of the thrust is in its effectiveness, {value:.3f}"
    text += f" ± {reach:.3f} of the file's at the end" if has_interval else " of the file's at the end"
    if effect.acts_on == "weight" and has_interval and value > 0:
        text += f": alone, {effect.name} would be {1 / value:.3f} ± {reach / value**2:.3f} of the file's"
    yield text


def _overlap(parameter: FollowedParameter, limits: InFlightThresholds) -> bool:
    reach = limits.interval * math.hypot(parameter.std, parameter.diagnosed_std)
    return abs(parameter.value - parameter.diagnosed) <= reach


def _changed(
    group: FollowedGroup, names: Sequence[str], followed: FollowedFlight, effect: Effect, limits: InFlightThresholds
) -> Iterator[str]:
    """That a parameter moved in flight, where the diagnosis has one value for all of it."""
    units = {p.name: p.unit for p in effect.parameters}
    for name in names:
        ends = followed.range_of(f"{group.key}.{name}", limits.max_unshown)
        if ends is None:
            continue
        low, high = ends
        if high.value - low.value > limits.changed * math.hypot(low.std, high.std):
            unit = "" if units[name] == "1" else f" {units[name]}"
            yield (
                f"{name} changed in flight, between {low.value:.3g} and {high.value:.3g}{unit}, and the diagnosis has "
                "one value for all of it"
            )


def _why_not_named(
    group: FollowedGroup, effect: Effect, diagnosis: Diagnosis, catalogue: Mapping[str, Effect]
) -> Iterator[str]:
    refused = next((r for r in diagnosis.refused if (r.name, r.rotor) == (group.name, group.rotor)), None)
    if refused is not None:
        yield f"the diagnosis does not name it: {reason_of(refused)}"
    elif group.name in diagnosis.not_excited:
        yield "the diagnosis does not name it: these flights excite it too little"
    elif alike := _look_alikes(effect, diagnosis, catalogue):
        yield f"the diagnosis names {' and '.join(alike)} instead, which looks like it in most flights"
    else:
        yield "the diagnosis explains the flights without it"


def _why_named_otherwise(
    group: FollowedGroup, effect: Effect, diagnosis: Diagnosis, catalogue: Mapping[str, Effect]
) -> Iterator[str]:
    own = next(e for e in diagnosis.effects if (e.name, e.rotor) == (group.name, group.rotor))
    if own.ambiguous_with:
        yield f"these flights cannot tell it from {' or '.join(own.ambiguous_with)}"
    elif alike := _look_alikes(effect, diagnosis, catalogue):
        yield f"the diagnosis names {' and '.join(alike)} beside it, which looks like it in most flights"


def _look_alikes(effect: Effect, diagnosis: Diagnosis, catalogue: Mapping[str, Effect]) -> list[str]:
    """Effects that are named and look like another one, as all drags do."""
    named = [catalogue[e.name] for e in diagnosis.effects if e.name != effect.name]
    return [
        other.name
        for other in named
        if other.name in effect.confounded_with
        or effect.name in other.confounded_with
        or (other.resists_air and effect.resists_air)
    ]


def flown_vehicle(followed: FollowedFlight, vehicle: Vehicle, catalogue: Mapping[str, Effect]) -> Vehicle:
    """The vehicle whose model flew, by its text in the recording; own effects are those of `vehicle`.

    Raises RequestError where the recording has none, or one that cannot be used with these effects.
    """
    if not followed.vehicle:
        raise RequestError(f"{followed.path} holds no vehicle file: it was cut off or not written by `alula fly`.")
    try:
        text = with_texts(followed.vehicle, vehicle.effect_files)
    except RequestError as error:
        raise RequestError(f"the vehicle file in {followed.path} is damaged: {error}") from None
    return parse_vehicle(text, catalogue=catalogue)


def constant_differences(flown: Vehicle, vehicle: Vehicle) -> list[str]:
    """In which constants of body and rotors two vehicles differ, in words."""
    different = []
    for section in ("body", "rotors"):
        one, other = (msgspec.to_builtins(getattr(which, section)) for which in (flown, vehicle))
        different += [
            f"{section}.{name} was {one.get(name)} in flight and is {other.get(name)} in the file"
            for name in {**one, **other}
            if one.get(name) != other.get(name)
        ]
    return different


def effect_differences(flown: Vehicle, vehicle: Vehicle, catalogue: Mapping[str, Effect]) -> list[str]:
    """In which effects two vehicles differ, in words."""
    one, other = (
        {use.label: {**catalogue[use.name].defaults(which), **use.parameters} for use in which.effects}
        for which in (flown, vehicle)
    )
    return [
        f"{label} was {_in_words(one.get(label))} in flight and is {_in_words(other.get(label))} in the file"
        for label in {**one, **other}
        if one.get(label) != other.get(label)
    ]


def _in_words(values: Mapping[str, float] | None) -> str:
    return "not there" if values is None else ", ".join(f"{name} = {value:g}" for name, value in values.items())
