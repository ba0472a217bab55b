"""Adding effects to a vehicle: joint fit, judged on held-out flights, written as the next version of its file."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np

from diagnosis.by_likelihood import LikelihoodAnswer, answer_by_likelihood
from diagnosis.data.data_checks import require_answerable
from diagnosis.data.dataset import Dataset
from diagnosis.diagnose import DiagnosisDetails, diagnose_dataset
from diagnosis.estimation.acceptance import (
    refused_of,
    with_faults_of,
    with_nuisances_of,
)
from diagnosis.estimation.evaluation import reduced_chi_square
from diagnosis.estimation.fitted import Fit, ParameterEstimate, left_out
from diagnosis.estimation.held_out import HeldOut
from diagnosis.estimation.paired_errors import relative_rise
from diagnosis.estimation.refusal import Refused, reason_of
from diagnosis.likelihood.evidence import IMPOSSIBLE
from diagnosis.models.channels import channel_name
from diagnosis.models.command_effects import without_command_effects
from diagnosis.models.open_loop import HorizonError, horizon_error
from diagnosis.one_thread import one_thread
from diagnosis.report import ChannelError, CommandGain, Diagnosis, refusal_sentence
from diagnosis.selection.candidates import Candidate, make_candidates
from diagnosis.thresholds import DEFAULT, RelevanceThresholds, Thresholds
from diagnosis.verdict import channel_errors
from dynamics.effect import Effect
from dynamics.effects import CATALOGUE
from dynamics.errors import DataError, RequestError
from dynamics.progress import Progress, no_progress, part_of
from dynamics.rate_loop import with_gains_kept
from dynamics.spelling import nearest
from dynamics.vehicle import HistoryEntry, Vehicle
from dynamics.vehicle_editing import edited_toml, rounded, rounded_changes
from dynamics.vehicle_file import vehicle_toml, with_effect_files, write_vehicle_text

ADVICE = "`alula diagnose` shows what is missing, if anything."
_VERSION = re.compile(r"\.v(\d+)$")


@dataclass(frozen=True, eq=False)
class Addition:
    """Effects that were added to a vehicle.

    vehicle: with the effects, and one more line of history.
    estimates: by (effect's key, parameter).
    channels: errors by kind, held out, before and after.
    keys: the effects' names in a model, the rotor in brackets.
    chi_square: reduced, held out, before and after; 1 where the residuals are noise.
    open_loop: prediction errors, held out, before and after, against the motion without the sensors' faults.
    refused: effects that were selected and not added.
    notes: to the user.
    """

    vehicle: Vehicle
    estimates: Mapping[tuple[str, str], ParameterEstimate]
    channels: Mapping[str, ChannelError]
    keys: tuple[str, ...]
    chi_square: tuple[float, float]
    open_loop: tuple[tuple[HorizonError, ...], tuple[HorizonError, ...]]
    refused: tuple[Refused, ...]
    notes: tuple[str, ...]


@one_thread
def add_effect(
    name: str | None,
    dataset: Dataset,
    vehicle: Vehicle,
    catalogue: Mapping[str, Effect],
    *,
    date: str,
    command: str = "",
    rotor: int | None = None,
    thresholds: Thresholds = DEFAULT,
    diagnosed: DiagnosisDetails | None = None,
    progress: Progress = no_progress,
) -> Addition:
    """Fit effects on the fitted flights and judge them on those held out. name: None for all that a diagnosis names.

    Values are the likelihood's, and so are those of the vehicle file's own effects where other ones matter.

    date, command: for the line of history. rotor: for an effect of one rotor; None for the one that fits best.
    diagnosed: the diagnosis of this data set and vehicle, where there is one already; of use without a name.
    Raises RequestError for an effect that is unknown, DataError where held-out flights do not bear it out or an error
    of any kind rises.
    """
    _require_addable(name, catalogue)
    require_answerable(dataset.everything, vehicle, thresholds)
    notes: tuple[str, ...] = ()
    if name is None:
        result = diagnosed or diagnose_dataset(dataset, vehicle, catalogue, thresholds, part_of(progress, 0.0, 0.5))
        notes = notes_of_set(result.diagnosis, catalogue)
        answer = result.likelihood
    else:
        progress(0.1, "signals of the catalogue's effects")
        answer = _likely(name, rotor, dataset, vehicle, catalogue, thresholds, part_of(progress, 0.1, 0.5))
    judge = HeldOut(answer.noise, dataset.held_out)
    progress(0.5, "each effect on held-out flights")
    accepted = _borne_out(answer, judge).accepted
    present, fitted = answer.vehicle_without, accepted.fit
    before = with_faults_of(fitted, present)
    progress(0.9, "errors on held-out flights")
    _require_no_loss(judge, present, before, fitted, thresholds.relevance)
    floor, sensors = judge.floor(fitted.vehicle), judge.sensors(fitted.vehicle)
    errors = channel_errors(judge.rows(present), judge.rows(fitted.vehicle), floor, sensors)
    _require_no_drift(fitted, vehicle, dataset, errors, thresholds.relevance)
    action = _action(fitted, vehicle)
    changed = rounded_changes(vehicle, with_gains_kept(vehicle, without_command_effects(fitted.vehicle), catalogue))
    changed = with_history(changed, action, dataset, errors, date=date, command=command)
    return Addition(
        vehicle=changed,
        estimates=fitted.estimates,
        channels=errors,
        keys=fitted.keys,
        chi_square=(
            reduced_chi_square(judge.rows(present), answer.noise.floor),
            reduced_chi_square(judge.rows(fitted.vehicle), answer.noise.floor),
        ),
        open_loop=(horizons_of(judge, before), horizons_of(judge, fitted.vehicle)),
        refused=accepted.refused,
        notes=(*notes, *(note for c in fitted.candidates for note in _caveat(fitted, c))),
    )


def _likely(
    name: str,
    rotor: int | None,
    dataset: Dataset,
    vehicle: Vehicle,
    catalogue: Mapping[str, Effect],
    thresholds: Thresholds,
    progress: Progress,
) -> LikelihoodAnswer:
    """The answer with one effect, on the rotor where it is likeliest. Raises DataError where it is not likely."""
    possible = make_candidates(vehicle, catalogue, dataset.fitted)
    able = {c.identity for c in possible if c.effect.name == name and rotor in (None, c.rotor)}
    if not able:
        raise DataError(
            f"these flights cannot show {name}"
            + (f" on rotor {rotor}" if rotor is not None else "")
            + ": with measured rotor speeds there is no motor lag, with commands alone no thrust "
            "constant, without voltage no sag. `alula diagnose` lists what they can show."
        )
    answer = answer_by_likelihood(dataset, vehicle, catalogue, thresholds, progress, one_of=able)
    if able & {one.candidate.identity for one in answer.named}:
        return answer
    search = answer.search
    odds = max(search.score([i]).evidence for i, c in enumerate(search.what.all) if c.identity in able)
    if odds == IMPOSSIBLE:
        raise DataError(
            f"{name} was not added: the values that fit these flights best lie outside its physical bounds. "
            "`alula diagnose` shows what is missing, if anything."
        )
    if odds >= search.problem.thresholds.named:
        raise DataError(
            f"{name} was not added: its best value is below what these flights can tell from none. {ADVICE}"
        )
    raise DataError(
        f"{name} was not added: these flights make it {np.exp(odds):.2g} times as likely as not, and "
        f"{np.exp(search.problem.thresholds.named):.0f} times are required. {ADVICE}"
    )


def _borne_out(answer: LikelihoodAnswer, judge: HeldOut) -> LikelihoodAnswer:
    """The answer with effects with each of which the open loop is better by more than chance, and faults of sensors.

    The weakest of the others is left out, until none is left. Raises DataError where nothing remains.
    """
    required = answer.noise.thresholds.relevance.deviations
    named = answer.accepted.fit.candidates
    while idle := _idle(answer.accepted.fit, answer.noise.vehicle, judge, required):
        weakest = min(idle, key=lambda candidate: idle[candidate])
        fitted = answer.accepted.fit
        refused = refused_of(fitted, weakest, "open_loop_alike", deviations=idle[weakest], required=required)
        answer = answer.without([refused])
    if named and not answer.accepted.fit.candidates:
        why = answer.accepted.refused
        reasons = "; ".join(refusal_sentence(one) for one in why if one.reason == "open_loop_alike")
        raise DataError(f"nothing was added: {reasons or reason_of(why[-1])}. {ADVICE}")
    return answer


def _idle(fitted: Fit, lacking: Vehicle, judge: HeldOut, required: float) -> dict[Candidate, float]:
    """Effects on the motion that improve the open loop by less than required, and by how many deviations they do.

    What lies between command and thrust stays as in the fit: no vehicle file holds it, and so it replaces no effect.
    """
    moving = [candidate for candidate in fitted.candidates if candidate.effect.moves_vehicle]
    without_each = {c: left_out(fitted, c, lacking, held=fitted.nuisances)[1] for c in moving}
    gains = {c: judge.improvement(fewer, fitted.vehicle) for c, fewer in without_each.items()}
    return {candidate: gain for candidate, gain in gains.items() if not gain >= required}


def _require_no_loss(
    judge: HeldOut, vehicle: Vehicle, before: Vehicle, fitted: Fit, limits: RelevanceThresholds
) -> None:
    """Raise DataError where an error rises from a vehicle to a fit by more than chance and by what matters.

    Nor is anything written with which the open loop is not better by more than chance.
    before: the vehicle with the fit's sensor faults.
    """
    names = ", ".join(fitted.keys)
    open_loop, alike_before = judge.worse_open_loop(before, fitted.vehicle), with_nuisances_of(fitted, vehicle)
    if open_loop and fitted.nuisances:
        alike = judge.worse_open_loop(alike_before, fitted.vehicle)
        open_loop = {where: change for where, change in open_loop.items() if where in alike}
    if worse := judge.worse_channels(vehicle, fitted.vehicle) | open_loop:
        listed = "; ".join(f"{where}: {c.before:.4g} before, {c.after:.4g} after" for where, c in worse.items())
        raise DataError(f"{names} was not added: on the held-out flights an error rises ({listed}). {ADVICE}")
    if any(c.effect.moves_vehicle for c in fitted.candidates):
        gain = judge.improvement(alike_before, fitted.vehicle)
        if not gain >= limits.deviations:
            raise DataError(
                f"{names} was not added: the open loop on held-out flights is not better by more than chance, "
                f"{gain:.2g} standard deviations of {limits.deviations:g}. {ADVICE}"
            )


def _require_no_drift(
    fitted: Fit,
    vehicle: Vehicle,
    dataset: Dataset,
    errors: Mapping[str, ChannelError],
    limits: RelevanceThresholds,
) -> None:
    """Raise DataError where a fit is worse than the vehicle was before the first addition from these same flights.

    Each addition may raise an error by what does not matter; several could raise it by more.
    """
    first = next((entry.before for entry in vehicle.history if entry.flights == _flights(dataset)), {})
    risen = [
        f"{channel_name(kind)}: {first[kind]:.4g} at first, {error.after:.4g} after"
        for kind, error in errors.items()
        if kind in first and relative_rise((error.after**2 - first[kind] ** 2) / error.floor**2) > limits.max_rise
    ]
    if risen:
        raise DataError(
            f"{', '.join(fitted.keys)} was not added: on the held-out flights an error would be larger than before "
            f"the first effect that was added from these flights ({'; '.join(risen)}). {ADVICE}"
        )


def _action(fitted: Fit, vehicle: Vehicle) -> str:
    """Action on a vehicle, as its history states it."""
    own = {(use.name, use.rotor) for use in vehicle.effects}
    parts = {
        "added": [c.key for c in fitted.candidates if c.identity not in own],
        "corrected": [c.key for c in fitted.candidates if c.identity in own],
    }
    return ", ".join(f"{verb} {', '.join(keys)}" for verb, keys in parts.items() if keys)


def horizons_of(judge: HeldOut, vehicle: Vehicle) -> tuple[HorizonError, ...]:
    """Prediction errors of a vehicle on held-out flights; empty where they hold no pose."""
    return tuple(horizon_error(h, np.vstack(parts)) for h, parts in judge.open_loop(vehicle).items())


def _require_addable(name: str | None, catalogue: Mapping[str, Effect]) -> None:
    if name is not None and name not in catalogue:
        raise RequestError(f"unknown effect {name!r}{nearest(name, catalogue)}. Known: {', '.join(catalogue)}.")
    if name is not None and catalogue[name].stochastic:
        raise DataError(_no_value(catalogue[name]))


def _no_value(effect: Effect) -> str:
    strength = effect.parameters[0].name
    return (
        f"a {effect.name} was not added: it is random, so no value in a vehicle file predicts it. Fly in still air to "
        f"find what else is missing; give the mock `--effect {effect.name}:{strength}=..` to fly in one."
    )


def notes_of_set(diagnosis: Diagnosis, catalogue: Mapping[str, Effect] = CATALOGUE) -> tuple[str, ...]:
    """Doubts about the effects of a diagnosis that a vehicle file can hold.

    Raises DataError when there is none.
    """
    if diagnosis.verdict == "explained":
        raise DataError("nothing was added: the model explains these flights down to the sensors' noise.")
    gain = () if diagnosis.command_gain is None else diagnosis.command_gain.look_alikes
    named = [e for e in diagnosis.effects if not catalogue[e.name].stochastic and e.name not in gain]
    if not named and gain:
        raise DataError(f"nothing was added: {_as_gain(diagnosis.command_gain)}.")
    if not named:
        raise DataError(
            _no_value(catalogue[diagnosis.effects[0].name])
            if diagnosis.effects
            else "nothing was added: something is missing, but no effect of the catalogue explains it. `alula compare` "
            "shows where the model fails; an effect of your own can be given with --effects."
        )
    notes = [
        f"there is a {e.name} as well, which no vehicle file can hold"
        for e in diagnosis.effects
        if catalogue[e.name].stochastic
    ]
    notes += [_as_gain(diagnosis.command_gain)] if gain else []
    if diagnosis.verdict == "unknown":
        names = ", ".join(effect.name for effect in named)
        notes.append(f"{names}: a part of what is missing at most; no effect of the catalogue explains the rest")
    for effect in named:
        if effect.ambiguous_with:
            others = ", ".join(effect.ambiguous_with)
            notes.append(f"these flights cannot tell {effect.name} from {others}: {diagnosis.next_flight}")
    return tuple(notes)


def _as_gain(gain: CommandGain | None) -> str:
    """Advice about a gain of the commands, which no fit tells from the motors' own."""
    assert gain is not None
    return (
        f"the rotors give {gain.value:.3g} times the thrust of the file for their commands, and commands alone do not "
        f"tell {', '.join(gain.look_alikes)} and the motors' own gain apart: weigh the vehicle; if body.mass is right, "
        f"multiply rotors.thrust_constant by {gain.value:.3g}, or log the rotors' speeds"
    )


def _caveat(fitted: Fit, candidate: Candidate) -> tuple[str, ...]:
    """The effect's own caveat with the fitted values in it, as a note; none where it has none."""
    if not candidate.effect.caveat:
        return ()
    values = {name: estimate.value for (key, name), estimate in fitted.estimates.items() if key == candidate.key}
    return (candidate.effect.caveat.format(**{**candidate.at, **values}),)


def with_history(
    vehicle: Vehicle, action: str, dataset: Dataset, errors: Mapping[str, ChannelError], *, date: str, command: str = ""
) -> Vehicle:
    """The vehicle with one more line of history: what was done, on which flights, and the errors before and after."""
    entry = HistoryEntry(
        date=date,
        action=action,
        flights=_flights(dataset),
        before={kind: rounded(error.before) for kind, error in errors.items()},
        after={kind: rounded(error.after) for kind, error in errors.items()},
        command=command,
    )
    return msgspec.structs.replace(vehicle, history=(*vehicle.history, entry))


def _flights(dataset: Dataset) -> tuple[str, ...]:
    """Name and digest of each log that is fitted, as a history has them."""
    return tuple(f"{Path(path).name} {digest[:16]}" for path, digest in dataset.hashes.items())


def write_next_version(
    vehicle: Vehicle, path: Path, *, catalogue: Mapping[str, Effect] = CATALOGUE, source: Path | None = None
) -> Path:
    """Write a vehicle next to its file under the next free version: vehicle.toml, vehicle.v2.toml, vehicle.v3.toml.

    Comments and layout are those of the file, or of `source`, that the vehicle was read from.
    Raises RequestError when it cannot be written.
    """
    text = text_after(vehicle, source or path, path.parent, catalogue=catalogue)
    match = _VERSION.search(path.stem)
    stem, version = (path.stem[: match.start()], int(match.group(1))) if match else (path.stem, 1)
    while True:
        version += 1
        following = path.with_name(f"{stem}.v{version}{path.suffix}")
        if not following.exists():
            write_vehicle_text(text, following)
            return following


def text_after(
    vehicle: Vehicle, source: Path | None, folder: Path, *, catalogue: Mapping[str, Effect] = CATALOGUE
) -> str:
    """The text of the file that a vehicle was read from with what has changed; written anew where there is none.

    folder: in which it will be written.
    """
    if source is None or not source.is_file():
        return vehicle_toml(vehicle)
    try:
        text = source.read_text(encoding="utf-8")
        if folder.resolve() != source.parent.resolve():
            text = with_effect_files(text, source.parent)
        return edited_toml(text, vehicle, folder=folder, catalogue=catalogue)
    except (RequestError, UnicodeDecodeError):  # another file has its place by now
        return vehicle_toml(vehicle)
