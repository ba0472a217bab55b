"""Adding an effect to a vehicle: joint fit, judged on held-out flights, written as the next version of its file."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec

from diagnosis.data.data_checks import require_answerable
from diagnosis.data.dataset import Dataset
from diagnosis.diagnose import diagnose_dataset
from diagnosis.estimation.equation_error import Fit, ParameterEstimate, fit
from diagnosis.estimation.evaluation import held_out_floor, reduced_chi_square, residuals_in
from diagnosis.estimation.output_error import refit
from diagnosis.models.open_loop import HorizonError, open_loop_errors
from diagnosis.report import ChannelError, Diagnosis
from diagnosis.selection.candidates import Candidate
from diagnosis.selection.regression import Regression, make_regression
from diagnosis.selection.search import IMPOSSIBLE, Search
from diagnosis.thresholds import DEFAULT, Thresholds
from diagnosis.verdict import channel_errors
from dynamics.arrays import Floats
from dynamics.effect import Effect
from dynamics.effects import CATALOGUE
from dynamics.errors import DataError, RequestError
from dynamics.vehicle import HistoryEntry, Vehicle
from dynamics.vehicle_file import nearest, write_vehicle

_VERSION = re.compile(r"\.v(\d+)$")


@dataclass(frozen=True, eq=False)
class Addition:
    """An effect that was added to a vehicle.

    vehicle: with the effect, and one more line of history.
    estimates: by (effect's key, parameter).
    channels: errors by kind, held out, before and after.
    key: the effect's name in a model, the rotor in brackets.
    chi_square: reduced, held out, before and after; 1 where the residuals are noise.
    open_loop: prediction errors, held out, before and after.
    by_output_error: whether that fit was better than equation error.
    notes: to the user.
    """

    vehicle: Vehicle
    estimates: Mapping[tuple[str, str], ParameterEstimate]
    channels: Mapping[str, ChannelError]
    key: str
    chi_square: tuple[float, float]
    open_loop: tuple[tuple[HorizonError, ...], tuple[HorizonError, ...]]
    by_output_error: bool
    notes: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class _Trial:
    """A fit with its residuals (m, 12) and reduced chi-square on the held-out flights."""

    fit: Fit
    rows: list[Floats]
    chi_square: float


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
) -> Addition:
    """Fit an effect on the fitted flights and judge it on those held out. name: None for the diagnosis' top effect.

    The effects that the vehicle file has are fitted again with it where that lowers the held-out error further, and
    all of them once more by output error where that does.

    date, command: for the line of history. rotor: for an effect of one rotor; None for the one that fits best.
    Raises RequestError for an effect that is unknown, DataError when the held-out error does not fall.
    """
    _require_addable(name, catalogue)
    require_answerable(dataset.everything, vehicle, thresholds)
    notes: tuple[str, ...] = ()
    if name is None:
        result = diagnose_dataset(dataset, vehicle, catalogue, thresholds)
        name, rotor, notes = top_effect(result.diagnosis, catalogue)
        regression = result.regression
    else:
        regression = make_regression(vehicle, catalogue, dataset.fitted, dataset.flight_of, thresholds)
    candidate = _best_candidate(regression, name, rotor)
    judge = _Judge(dataset, regression)
    before = judge.rows(vehicle)
    trials = [judge.trial(fit(regression, [candidate, *own])) for own in _refitted_with(regression, candidate)]
    best = min(trials, key=lambda trial: trial.chi_square)
    better = judge.by_output_error(best, vehicle)
    now, was = better or best, reduced_chi_square(before, regression.noise)
    if not now.chi_square < thresholds.acceptance.max_ratio * was:
        raise DataError(
            f"{name} was not added: on the held-out flights the error does not fall (squared error over noise "
            f"{was:.4g} before, {now.chi_square:.4g} after). `alula diagnose` shows what is missing, if anything."
        )
    floor = held_out_floor(regression, dataset.held_out, now.rows)
    errors = channel_errors(before, now.rows, regression, floor)
    return Addition(
        vehicle=with_history(now.fit.vehicle, f"added {candidate.key}", dataset, errors, date=date, command=command),
        estimates=now.fit.estimates,
        channels=errors,
        key=candidate.key,
        chi_square=(was, now.chi_square),
        open_loop=(judge.open_loop(vehicle), judge.open_loop(now.fit.vehicle)),
        by_output_error=better is not None,
        notes=(*notes, *_caveat(now.fit, candidate)),
    )


class _Judge:
    """Errors of vehicles on the held-out flights, under the noise of one regression."""

    def __init__(self, dataset: Dataset, regression: Regression) -> None:
        self._dataset, self._regression = dataset, regression

    def rows(self, vehicle: Vehicle) -> list[Floats]:
        return residuals_in(self._regression, vehicle, self._dataset.held_out)

    def trial(self, fitted: Fit) -> _Trial:
        rows = self.rows(fitted.vehicle)
        return _Trial(fitted, rows, reduced_chi_square(rows, self._regression.noise))

    def by_output_error(self, best: _Trial, vehicle: Vehicle) -> _Trial | None:
        """The same parameters fitted by output error, None where that does not lower the held-out error."""
        catalogue, dataset, thresholds = self._regression.catalogue, self._dataset, self._regression.thresholds
        again = refit(best.fit, vehicle, catalogue, dataset.fitted, dataset.held_out, thresholds)
        if again is None or not again.after < again.before:
            return None
        trial = self.trial(again.fit)
        limit = thresholds.output_error.max_one_step_growth * best.chi_square
        return trial if trial.chi_square < limit else None

    def open_loop(self, vehicle: Vehicle) -> tuple[HorizonError, ...]:
        """Open-loop errors, none without a pose."""
        held_out, regression = self._dataset.held_out, self._regression
        if any(s.lacks for s in held_out):
            return ()
        return open_loop_errors(vehicle, regression.catalogue, held_out, regression.thresholds.prediction)


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


def top_effect(
    diagnosis: Diagnosis, catalogue: Mapping[str, Effect] = CATALOGUE
) -> tuple[str, int | None, tuple[str, ...]]:
    """The first effect of a diagnosis that a vehicle file can hold, its rotor, and what was doubtful about it.

    Raises DataError when there is none.
    """
    if diagnosis.verdict == "explained":
        raise DataError("nothing was added: the model explains these flights down to the sensors' noise.")
    named = [effect for effect in diagnosis.effects if not catalogue[effect.name].stochastic]
    if not named:
        raise DataError(
            _no_value(catalogue[diagnosis.effects[0].name])
            if diagnosis.effects
            else "nothing was added: something is missing, but no effect of the catalogue explains it. `alula compare` "
            "shows where the model fails; an effect of your own can be given with --effects."
        )
    top, notes = named[0], []
    if top is not diagnosis.effects[0]:
        notes.append(f"there is a {diagnosis.effects[0].name} as well, which no vehicle file can hold")
    if diagnosis.verdict == "unknown":
        notes.append(f"{top.name} is a part of what is missing at most: no effect of the catalogue explains the rest")
    if top.ambiguous_with:
        notes.append(
            f"these flights cannot tell {top.name} from {', '.join(top.ambiguous_with)}: {diagnosis.next_flight}"
        )
    return top.name, top.rotor, tuple(notes)


def _caveat(fitted: Fit, candidate: Candidate) -> tuple[str, ...]:
    """The effect's own caveat with the fitted values in it, as a note; none where it has none."""
    if not candidate.effect.caveat:
        return ()
    values = {name: estimate.value for (key, name), estimate in fitted.estimates.items() if key == candidate.key}
    return (candidate.effect.caveat.format(**{**candidate.at, **values}),)


def _refitted_with(regression: Regression, added: Candidate) -> list[Sequence[Candidate]]:
    """What may be fitted with the added effect: nothing, or the vehicle file's own effects."""
    names = {(use.name, use.rotor) for use in regression.vehicle.effects}
    own = [
        c
        for c in regression.candidates
        if (c.effect.name, c.rotor) in names and c.key != added.key and not c.fixed_shape
    ]
    return [(), own] if own else [()]


def with_history(
    vehicle: Vehicle, action: str, dataset: Dataset, errors: Mapping[str, ChannelError], *, date: str, command: str = ""
) -> Vehicle:
    """The vehicle with one more line of history: what was done, on which flights, and the errors before and after."""
    entry = HistoryEntry(
        date=date,
        action=action,
        flights=tuple(f"{Path(path).name} {digest[:16]}" for path, digest in dataset.hashes.items()),
        before={kind: float(f"{error.before:.6g}") for kind, error in errors.items()},
        after={kind: float(f"{error.after:.6g}") for kind, error in errors.items()},
        command=command,
    )
    return msgspec.structs.replace(vehicle, history=(*vehicle.history, entry))


def write_next_version(vehicle: Vehicle, path: Path) -> Path:
    """Write a vehicle next to its file under the next free version: vehicle.toml, vehicle.v2.toml, vehicle.v3.toml.

    Raises RequestError when it cannot be written.
    """
    match = _VERSION.search(path.stem)
    stem, version = (path.stem[: match.start()], int(match.group(1))) if match else (path.stem, 1)
    while True:
        version += 1
        following = path.with_name(f"{stem}.v{version}{path.suffix}")
        if not following.exists():
            write_vehicle(vehicle, following)
            return following


def _best_candidate(regression: Regression, name: str, rotor: int | None) -> Candidate:
    search = Search(regression)
    candidates = [c for c in regression.candidates if c.effect.name == name and rotor in (None, c.rotor)]
    if not candidates:
        raise DataError(
            f"these flights cannot show {name}"
            + (f" on rotor {rotor}" if rotor is not None else "")
            + ": with measured rotor speeds there is no motor lag, with commands alone no mass, without voltage "
            "no sag. `alula diagnose` lists what they can show."
        )
    best = max((search.score([c]) for c in candidates), key=lambda s: s.score)
    if best.score == IMPOSSIBLE:
        raise DataError(
            f"{name} was not added: the values that fit these flights best lie outside its physical bounds. "
            "`alula diagnose` shows what is missing, if anything."
        )
    return best.candidates[0]
