"""Step "explain": what one effect explains, and score and error for every value of its parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np

from diagnosis.by_likelihood import fit_of
from diagnosis.diagnose import DiagnosisDetails
from diagnosis.estimation.evaluation import residuals_in
from diagnosis.estimation.fitted import Fit
from diagnosis.models.channels import KINDS, squared_by_kind
from diagnosis.regimes import regime_maps
from diagnosis.selection.candidates import Candidate
from diagnosis.spectrum import residual_spectrum
from diagnosis.thresholds import DEFAULT
from diagnosis.tried import Tried
from dynamics.arrays import Floats
from dynamics.effect import Parameter
from dynamics.effect_card import EffectCard
from dynamics.errors import DataError
from dynamics.files import write_json
from dynamics.progress import Progress
from dynamics.vehicle import EffectUse, Vehicle
from studio.pages import diagnosed as pictures
from studio.pages import regions
from studio.pages.numbers import unit_shown
from studio.work.arrays import write_arrays
from studio.work.memory import CaseMemory
from studio.work.results import FILES, GRID, Evidence, Slider
from studio.work.rows import picture_info
from studio.work.task import Task


def explain(memory: CaseMemory, task: Task, folder: Path, progress: Progress) -> None:
    """Fit one effect, and write what it explains: rows (m, 12) with it, and over a grid of each parameter."""
    details = memory.diagnosis(task, lambda share, stage: progress(0.5 * share, stage))
    dataset, noise = memory.dataset(task), details.noise
    tried = _tried(details, task.effect)
    candidate = tried.candidate
    progress(0.5, f"fit of {candidate.key}")
    fits = _fits(details, tried)
    fitted, segments = fits.fitted, dataset.everything
    before = residuals_in(noise, fits.without, segments)
    after = residuals_in(noise, fitted.vehicle, segments)
    floor = noise.floor
    sliders, grids = [], {}
    shown = [p for p in candidate.effect.parameters if p.name in candidate.at]
    for number, parameter in enumerate(shown):
        progress(0.6 + 0.4 * number / len(shown), f"errors for values of {parameter.name}")
        values, best = _grid(parameter, fitted, candidate, noise.vehicle)
        tables = [residuals_in(noise, _moved(fitted, candidate, parameter.name, v), segments) for v in values]
        grids[f"grid_{number}"] = np.array([np.vstack(t) for t in tables], dtype=np.float32)
        rms = [_over_floor(table, floor) for table in tables]
        std = fitted.estimates[candidate.key, parameter.name].std if parameter.name in fits.free else 0.0
        sliders.append(Slider(parameter.name, parameter.unit, values.tolist(), best, std, rms))
    write_arrays(folder, {"improved": np.vstack(after).astype(np.float32), **grids})
    maps = regime_maps(segments, after, floor, noise.vehicle, DEFAULT.regimes)
    spectra = [residual_spectrum(r, noise) for r in (before, after)]
    evidence = Evidence(
        key=candidate.key,
        formula="\n".join(EffectCard(candidate.effect, None, ()).formula),
        value=_value(fitted, candidate.key),
        score=tried.score,
        fitted_with=fits.fitted_with,
        sliders=tuple(sliders),
        share=_shares(before, after, floor),
        pictures={
            "regimes_after": picture_info(regions.regime_map(maps)),
            "spectrum": picture_info(pictures.spectrum_lines(*spectra)),
        },
    )
    write_json(evidence, folder / FILES[Evidence])


def _tried(details: DiagnosisDetails, key: str) -> Tried:
    """An effect at the point that fits best. Raises DataError for one that was not tried."""
    for one in details.tried:
        if one.candidate.key == key:
            return one
    raise DataError(f"these flights cannot show {key}, so it was not tried. The check lists what they can show.")


@dataclass(frozen=True, eq=False)
class _Fits:
    """The fit with an effect, and the vehicle of that without it.

    free: names of the effect's parameters that were fitted. fitted_with: keys of the others that both have.
    """

    fitted: Fit
    without: Vehicle
    free: tuple[str, ...]
    fitted_with: tuple[str, ...]


def _fits(details: DiagnosisDetails, tried: Tried) -> _Fits:
    """Beside the other effects that are named, with the answer's values and intervals.

    Raises DataError where the values that fit best are physically impossible.
    """
    answer, candidate = details.likelihood, tried.candidate
    if tried.score is None:
        raise DataError(
            f"the values of {candidate.key} that fit these flights best are physically impossible, so there is "
            "nothing to show of it. Look at the effects above it, or at another flight."
        )
    others = [one for one in answer.named if one.number != tried.number]
    numbers = [one.number for one in others]
    fitted, without = fit_of(answer.search, [*numbers, tried.number]), fit_of(answer.search, numbers).vehicle
    free = tuple(name for key, name in fitted.estimates if key == candidate.key)
    return _Fits(fitted, without, free, tuple(one.candidate.key for one in others))


def _grid(parameter: Parameter, fitted: Fit, candidate: Candidate, vehicle: Vehicle) -> tuple[Floats, int]:
    """Values (g,) of a parameter from where the effect is absent to twice its best value, and the place of the best.

    They hold the 95 % interval, and are about the usual value where the best one is no different from neutral. Within
    the parameter's bounds.
    """
    best = _use(fitted, candidate).parameters[parameter.name]
    estimate = fitted.estimates.get((candidate.key, parameter.name))
    std = 0.0 if estimate is None else estimate.std
    reach = max(abs(best - parameter.neutral), 3 * std) or 2 * parameter.prior(vehicle).std
    values = best + reach * np.linspace(-1.0, 1.0, GRID)
    inside = np.clip(values, parameter.lower, parameter.upper)
    return inside, GRID // 2


def _use(fitted: Fit, candidate: Candidate) -> EffectUse:
    return next(use for use in fitted.vehicle.effects if (use.name, use.rotor) == candidate.identity)


def _moved(fitted: Fit, candidate: Candidate, name: str, value: float) -> Vehicle:
    """A fit's vehicle with one parameter of one effect at another value."""
    own = _use(fitted, candidate)
    moved = msgspec.structs.replace(own, parameters={**own.parameters, name: float(value)})
    return msgspec.structs.replace(
        fitted.vehicle, effects=tuple(moved if use is own else use for use in fitted.vehicle.effects)
    )


def _over_floor(rows: Sequence[Floats], floor: Floats) -> list[float | None]:
    """RMS of each kind of channel over its floor, None where it is absent."""
    squares, levels = np.mean(squared_by_kind(np.vstack(rows)), axis=0), squared_by_kind(floor)
    return [float(np.sqrt(s / level)) if level > 0 else None for s, level in zip(squares, levels, strict=True)]


def _shares(before: Sequence[Floats], after: Sequence[Floats], floor: Floats) -> dict[str, float]:
    """By kind of channel, the part of the squared error above the floor that is gone."""
    was, now = (np.mean(squared_by_kind(np.vstack(rows)), axis=0) for rows in (before, after))
    above = was - squared_by_kind(floor)
    gone = np.divide(was - now, above, out=np.zeros_like(was), where=above > 0)
    return {kind: float(np.clip(share, -1.0, 1.0)) for kind, share in zip(KINDS, gone, strict=True)}


def _value(fitted: Fit, key: str) -> str:
    return ", ".join(
        f"{name} {estimate.value:.4g} ± {1.96 * estimate.std:.2g} {unit_shown(estimate.unit)}".rstrip()
        for (owner, name), estimate in fitted.estimates.items()
        if owner == key
    )
