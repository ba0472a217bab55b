"""The next vehicle file from what a model followed in flight, if the flight's own errors do not rise with it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import msgspec

from diagnosis.addition import ADVICE
from diagnosis.by_likelihood import filter_required, fit_of, noise_of, problems_of
from diagnosis.data.data_checks import require_answerable
from diagnosis.data.dataset import Dataset
from diagnosis.estimation.held_out import HeldOut
from diagnosis.in_flight import (
    FollowedGroup,
    constant_differences,
    effect_differences,
    flown_vehicle,
    followed_groups,
    in_effectiveness,
    is_shown,
)
from diagnosis.likelihood.given_set import fit_set
from diagnosis.one_thread import one_thread
from diagnosis.report import ChannelError, ParameterValue
from diagnosis.thresholds import DEFAULT, InFlightThresholds
from diagnosis.verdict import channel_errors
from dynamics.effect import Effect
from dynamics.errors import DataError, RequestError
from dynamics.rate_loop import with_gains_kept
from dynamics.vehicle import EffectUse, HistoryEntry, Vehicle
from dynamics.vehicle_editing import rounded, rounded_changes
from flights.followed import FollowedFlight

Why = Literal["no_change", "not_shown", "air"]


class LeftOut(msgspec.Struct, frozen=True):
    """An effect that was followed in flight and is not in the next vehicle file.

    effect: its name in a model, the rotor in brackets.
    why: "no_change" where the interval holds the file's own value, "not_shown" where the flight did not show it, "air"
        for the wind of that flight.
    parameters: as they were followed.
    """

    effect: str
    why: Why
    parameters: dict[str, ParameterValue]


@dataclass(frozen=True, eq=False)
class FlightAddition:
    """Addition of a flight's followed parameters to its vehicle.

    vehicle: with the values at the end of tracking, and one more line of history.
    parameters: of the effects in it that were followed, by their names in a model.
    left_out: effects that were followed and are not in it.
    channels: errors of the flight by kind, with the file's model and with what was added, each in the air that fits it
        best; empty where the recording does not show them.
    notes: to the user.
    """

    vehicle: Vehicle
    parameters: Mapping[str, dict[str, ParameterValue]]
    left_out: tuple[LeftOut, ...]
    channels: Mapping[str, ChannelError]
    notes: tuple[str, ...]


class FlightAdditionReport(msgspec.Struct, frozen=True):
    """Document that `alula add --from-flight --json` writes.

    effects: names in a model of what was added or corrected, the rotor in brackets.
    parameters: of these, as they were followed.
    mode: "on", or "shadow" where they were estimated and not flown.
    left_out: what was followed and is not in the file, each with its reason.
    channels: RMS on the flight with the file's model and with what was added, each in the air that fits it best, and
        floor; empty where the recording does not show them.
    notes: to the user.
    vehicle: the file that was written.
    """

    effects: tuple[str, ...]
    parameters: dict[str, dict[str, ParameterValue]]
    mode: str
    left_out: tuple[LeftOut, ...]
    channels: dict[str, ChannelError]
    notes: tuple[str, ...]
    vehicle: str = ""


def flight_report(addition: FlightAddition, followed: FollowedFlight) -> FlightAdditionReport:
    """An addition as a program reads it, but for the name of the file."""
    return FlightAdditionReport(
        effects=tuple(addition.parameters),
        parameters=dict(addition.parameters),
        mode=followed.mode,
        left_out=addition.left_out,
        channels=dict(addition.channels),
        notes=addition.notes,
    )


def require_own_flight(followed: FollowedFlight, vehicle: Vehicle, catalogue: Mapping[str, Effect]) -> None:
    """Raise RequestError unless a flight was flown with a vehicle's model, DataError where it followed nothing."""
    flown = flown_vehicle(followed, vehicle, catalogue)
    different = constant_differences(flown, vehicle) + effect_differences(flown, vehicle, catalogue)
    if different:
        more = f", and {len(different) - 1} more" if len(different) > 1 else ""
        raise RequestError(
            f"{followed.path} was flown with another vehicle file than {vehicle.name}'s: {different[0]}{more}. What "
            "was followed belongs to the model that flew: give the file that flew, or fly with this one."
        )
    if not followed.values:
        raise DataError(
            f"{followed.path} followed a disturbance and no effect by name, so there is nothing for a vehicle file. "
            "Fly with --follow EFFECT, or `alula diagnose` the recording."
        )


@one_thread
def add_followed(
    followed: FollowedFlight,
    vehicle: Vehicle,
    catalogue: Mapping[str, Effect],
    dataset: Dataset | None,
    *,
    effect: str | None = None,
    date: str,
    command: str = "",
    limits: InFlightThresholds = DEFAULT.in_flight,
) -> FlightAddition:
    """Put what a model followed into its vehicle, where the flight shows that it is not as the file has it.

    dataset: of the same recording, None where it cannot be read as flights: errors are then not compared.
    effect: the one to add, the air's too; by default all but the air's.
    date, command: for the line of history.
    Raises RequestError for another vehicle's flight or an effect that was not followed, DataError where nothing changes
    or an error of the flight rises.
    """
    require_own_flight(followed, vehicle, catalogue)
    groups = {group.key: group for group in followed_groups(followed)}
    chosen = _chosen(groups, effect)
    left_out = tuple(
        LeftOut(key, why, _parameters(group, catalogue))
        for key, group in groups.items()
        if key in chosen and (why := _why_left_out(group, vehicle, catalogue, limits, named=effect is not None))
    )
    added = [group for key, group in chosen.items() if key not in {one.effect for one in left_out}]
    if not added:
        reasons = [*map(left_out_sentence, left_out), *_gains(chosen, followed, catalogue)]
        raise DataError(f"nothing was added from {followed.path}: {'; '.join(reasons)}.")
    air = [one.effect for one in left_out if one.why == "air"]
    changed = rounded_changes(vehicle, with_gains_kept(vehicle, _with_values(vehicle, added, catalogue), catalogue))
    channels, notes = _errors(vehicle, changed, catalogue, dataset, air)
    if air and channels:
        notes = (*notes, "errors before and after are in the air that fits the flight best")
    return FlightAddition(
        vehicle=_with_history(changed, vehicle, added, followed, channels, date=date, command=command),
        parameters={group.key: _parameters(group, catalogue) for group in added},
        left_out=left_out,
        channels=channels,
        notes=(
            *_flight_notes(followed),
            *notes,
            *_gains(chosen, followed, catalogue),
            *(note for group in added for note in _caveat(group, catalogue)),
        ),
    )


def left_out_sentence(left_out: LeftOut) -> str:
    """Why an effect is not in the next vehicle file, with its values, without a full stop."""
    values = ", ".join(
        f"{name} = {p.value:.4g} ± {DEFAULT.in_flight.interval * p.std:.2g}{'' if p.unit == '1' else f' {p.unit}'}"
        for name, p in left_out.parameters.items()
    )
    reason = {
        "no_change": "the interval holds the vehicle file's value",
        "not_shown": "the flight did not show it",
        "air": "it is the air of that flight and not the vehicle; name it to add it anyway",
    }[left_out.why]
    return f"{left_out.effect} ({values}): {reason}"


def _chosen(groups: Mapping[str, FollowedGroup], effect: str | None) -> dict[str, FollowedGroup]:
    chosen = {key: group for key, group in groups.items() if effect in (None, group.name)}
    if not chosen:
        raise RequestError(f"{effect} was not followed in this flight. It followed {', '.join(groups)}.")
    return chosen


def _why_left_out(
    group: FollowedGroup, vehicle: Vehicle, catalogue: Mapping[str, Effect], limits: InFlightThresholds, *, named: bool
) -> Why | None:
    effect = catalogue[group.name]
    shown = {name: value for name, value in group.values.items() if is_shown(value, limits)}
    if not shown:
        return "not_shown"
    before = _values_before(group, vehicle, effect)
    if all(abs(value.value - before[name]) <= limits.interval * value.std for name, value in shown.items()):
        return "no_change"
    return "air" if effect.wind is not None and not named else None


def _values_before(group: FollowedGroup, vehicle: Vehicle, effect: Effect) -> dict[str, float]:
    """Values of an effect in the file's model; neutral ones where it lacks the effect, as the flight began with.

    Of a loss of thrust that was named in flight: none, since it is a step from what was modelled.
    """
    neutral = {p.name: p.neutral for p in effect.parameters}
    use = _use_of(group, vehicle)
    own = neutral if use is None else {**effect.defaults(vehicle), **use.parameters}
    return {**own, effect.lost_thrust: 0.0} if effect.lost_thrust else own


def _use_of(group: FollowedGroup, vehicle: Vehicle) -> EffectUse | None:
    return next((use for use in vehicle.effects if (use.name, use.rotor) == (group.name, group.rotor)), None)


def _with_values(vehicle: Vehicle, groups: list[FollowedGroup], catalogue: Mapping[str, Effect]) -> Vehicle:
    """The vehicle with the followed values of effects; what was not followed of them stays as it flew."""
    for group in groups:
        effect = catalogue[group.name]
        use = _use_of(group, vehicle)
        values = {p.name: p.neutral for p in effect.parameters}
        values |= {} if use is None else {**effect.defaults(vehicle), **use.parameters}
        past_loss = values.get(effect.lost_thrust, 0.0)
        values |= {name: value.value for name, value in group.values.items()}
        if effect.lost_thrust in group.values:
            values[effect.lost_thrust] = 1 - (1 - past_loss) * (1 - values[effect.lost_thrust])
        vehicle = vehicle.with_effect_replaced(EffectUse(group.name, values, group.rotor))
    return vehicle


def _errors(
    vehicle: Vehicle, changed: Vehicle, catalogue: Mapping[str, Effect], dataset: Dataset | None, air: Sequence[str]
) -> tuple[dict[str, ChannelError], tuple[str, ...]]:
    """Errors of the flight with the vehicle before and after; a note where there are none.

    air: effects of the flight's air, which is in neither: it is fitted to either of them, so that none pays for it.
    Raises DataError where one rises by more than chance and enough to matter.
    """
    if dataset is None:
        return {}, ("the errors before and after were not compared: the recording cannot be read as a flight",)
    try:
        require_answerable(dataset.everything, vehicle)
        before, after = (_as_flown(which, catalogue, dataset, air) for which in (vehicle, changed))
        noise = noise_of(dataset, vehicle, catalogue)
    except DataError as error:
        return {}, (f"the errors before and after were not compared: {error}",)
    judge = HeldOut(noise, dataset.everything)
    if worse := judge.worse_channels(before, after):
        listed = "; ".join(f"{where}: {c.before:.4g} before, {c.after:.4g} after" for where, c in worse.items())
        raise DataError(f"nothing was added: with what was followed, an error of the flight rises ({listed}). {ADVICE}")
    return channel_errors(judge.rows(before), judge.rows(after), judge.floor(after), judge.sensors(after)), ()


def _as_flown(vehicle: Vehicle, catalogue: Mapping[str, Effect], dataset: Dataset, air: Sequence[str]) -> Vehicle:
    """A vehicle with the effects of the air, and what lies between its commands and thrust, that fit a flight best."""
    problems = problems_of(dataset, vehicle, catalogue)
    what = problems[0].what
    blowing = [number for number, candidate in enumerate(what.all) if candidate.key in air]
    if not blowing and not what.of_commands:
        return vehicle
    with filter_required():
        return fit_of(fit_set(problems, blowing).search, blowing).vehicle


def _with_history(
    changed: Vehicle,
    vehicle: Vehicle,
    added: list[FollowedGroup],
    followed: FollowedFlight,
    channels: Mapping[str, ChannelError],
    *,
    date: str,
    command: str,
) -> Vehicle:
    parts = {
        "added": [group.key for group in added if _use_of(group, vehicle) is None],
        "corrected": [group.key for group in added if _use_of(group, vehicle) is not None],
    }
    action = ", ".join(f"{verb} {', '.join(keys)}" for verb, keys in parts.items() if keys)
    entry = HistoryEntry(
        date=date,
        action=f"{action}, as followed in flight",
        flights=(f"{followed.path.name} {followed.sha256[:16]}",),
        before={kind: rounded(error.before) for kind, error in channels.items()},
        after={kind: rounded(error.after) for kind, error in channels.items()},
        command=command,
    )
    return msgspec.structs.replace(changed, history=(*changed.history, entry))


def _flight_notes(followed: FollowedFlight) -> tuple[str, ...]:
    notes = []
    if followed.mode == "shadow":
        notes.append("it was estimated in shadow: these values have not been flown yet")
    if followed.trust[followed.last, 0] < 1.0:
        notes.append(
            "at the end of tracking the flight did not trust what it estimated: it forecast worse than the file's model"
        )
    if not followed.tracked.any():
        notes.append("the reference was not tracked: the values are those at the end of the recording")
    return tuple(notes)


def _gains(
    groups: Mapping[str, FollowedGroup], followed: FollowedFlight, catalogue: Mapping[str, Effect]
) -> tuple[str, ...]:
    return tuple(note for group in groups.values() for note in in_effectiveness(followed, catalogue[group.name]))


def _parameters(group: FollowedGroup, catalogue: Mapping[str, Effect]) -> dict[str, ParameterValue]:
    units = {p.name: p.unit for p in catalogue[group.name].parameters}
    return {name: ParameterValue(value.value, value.std, units[name]) for name, value in group.values.items()}


def _caveat(group: FollowedGroup, catalogue: Mapping[str, Effect]) -> tuple[str, ...]:
    """The effect's own caveat with the followed values in it."""
    effect = catalogue[group.name]
    values = {p.name: p.neutral for p in effect.parameters} | {n: value.value for n, value in group.values.items()}
    return (effect.caveat.format(**values),) if effect.caveat else ()
