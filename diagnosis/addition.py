"""Adding an effect to a vehicle: joint fit, judged on held-out flights, written as the next version of its file."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import msgspec

from diagnosis.candidates import Candidate
from diagnosis.dataset import Dataset
from diagnosis.diagnose import IMPROVEMENT
from diagnosis.evaluation import misfit, residuals
from diagnosis.fit import Estimate, fit
from diagnosis.fitness import require_answerable
from diagnosis.regression import Regression, make_regression
from diagnosis.report import ChannelError
from diagnosis.selection import IMPOSSIBLE, Search
from diagnosis.verdict import channel_errors
from dynamics.effect import Effect
from dynamics.errors import DataError, RequestError
from dynamics.vehicle import HistoryEntry, Vehicle
from dynamics.vehicle_file import nearest, write_vehicle

_VERSION = re.compile(r"\.v(\d+)$")


@dataclass(frozen=True, eq=False)
class Addition:
    """vehicle: with the effect, its history one line longer. estimates: by (effect's key, parameter)."""

    vehicle: Vehicle
    estimates: Mapping[tuple[str, str], Estimate]
    channels: Mapping[str, ChannelError]


def add_effect(
    name: str,
    dataset: Dataset,
    vehicle: Vehicle,
    catalogue: Mapping[str, Effect],
    *,
    date: str,
    command: str = "",
    rotor: int | None = None,
) -> Addition:
    """Fit an effect on the fitted flights and judge it on those held out.

    The effects that the vehicle file has are fitted again with it where that lowers the held-out error further.

    date, command: for the line of history. rotor: for an effect of one rotor; None for the one that fits best.
    Raises RequestError for an effect that is unknown, DataError when the held-out error does not fall.
    """
    if name not in catalogue:
        raise RequestError(f"unknown effect {name!r}{nearest(name, catalogue)}. Known: {', '.join(catalogue)}.")
    require_answerable(dataset.everything, vehicle)
    regression = make_regression(vehicle, catalogue, dataset.fitted, dataset.flight_of)
    candidate = _best_variant(regression, name, rotor)
    before = residuals(vehicle, catalogue, dataset.held_out, regression.noise)
    trials = [fit(regression, [candidate, *refitted]) for refitted in ((), _known(regression, candidate))]
    judged = [residuals(trial.vehicle, catalogue, dataset.held_out, regression.noise) for trial in trials]
    now, after, fitted = min(
        ((misfit(rows, regression.noise), rows, trial) for rows, trial in zip(judged, trials, strict=True)),
        key=lambda found: found[0],
    )
    was = misfit(before, regression.noise)
    if not now < IMPROVEMENT * was:
        raise DataError(
            f"{name} was not added: on the held-out flights the error does not fall (squared error over noise "
            f"{was:.4g} before, {now:.4g} after). `alula diagnose` says what is missing, if anything."
        )
    errors = channel_errors(before, after, regression)
    entry = HistoryEntry(
        date=date,
        action=f"added {candidate.key}",
        flights=tuple(f"{Path(path).name} {digest[:16]}" for path, digest in dataset.hashes.items()),
        before={kind: float(f"{error.before:.6g}") for kind, error in errors.items()},
        after={kind: float(f"{error.after:.6g}") for kind, error in errors.items()},
        command=command,
    )
    updated = msgspec.structs.replace(fitted.vehicle, history=(*vehicle.history, entry))
    return Addition(updated, fitted.estimates, errors)


def write_next_version(vehicle: Vehicle, path: Path) -> Path:
    """Write a vehicle beside its file under the next free version: vehicle.toml, vehicle.v2.toml, vehicle.v3.toml.

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


def _known(regression: Regression, added: Candidate) -> tuple[Candidate, ...]:
    """The candidates that are the vehicle file's own effects, but for the one that is added."""
    held = {(use.name, use.rotor) for use in regression.vehicle.effects}
    return tuple(
        c for c in regression.candidates if (c.effect.name, c.rotor) in held and c.key != added.key and not c.whole
    )


def _best_variant(regression: Regression, name: str, rotor: int | None) -> Candidate:
    search = Search(regression)
    mine = [c for c in regression.candidates if c.effect.name == name and rotor in (None, c.rotor)]
    if not mine:
        raise DataError(
            f"these flights cannot show {name}"
            + (f" on rotor {rotor}" if rotor is not None else "")
            + ": with measured rotor speeds there is no motor lag to see, without voltage no sag, and a gust has no "
            "value that a model could hold. `alula diagnose` lists what they can show."
        )
    best = max((search.score([c]) for c in mine), key=lambda s: s.score)
    if best.score == IMPOSSIBLE:
        raise DataError(
            f"{name} was not added: the values that fit these flights best lie outside its physical bounds. "
            "`alula diagnose` says what is missing, if anything."
        )
    return best.candidates[0]
