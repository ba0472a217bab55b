"""Step "diagnose": which effect is missing, with the ranking and its evidence."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from diagnosis.diagnose import DiagnosisDetails
from diagnosis.estimation.evaluation import residuals_in
from diagnosis.estimation.refusal import reason_of
from diagnosis.regimes import regime_maps
from diagnosis.report import Considered, Diagnosis, evidence_sentence, leftover_sentence, sentence
from diagnosis.spectrum import residual_spectrum
from diagnosis.thresholds import DEFAULT
from dynamics.effect import Effect
from dynamics.effects import CATALOGUE
from dynamics.files import write_json
from dynamics.progress import Progress
from studio.pages import diagnosed as pictures
from studio.pages import regions
from studio.pages.evidence import likeness
from studio.pages.followed import effects_of, followed_picture
from studio.pages.numbers import unit_shown
from studio.work.memory import CaseMemory
from studio.work.results import FILES, FOLLOWED, Diagnosed, RankedEffect
from studio.work.rows import picture_info, write_rows
from studio.work.task import Task

OUTCOMES = {
    "named": "",
    "not_selected": "others explain these flights better, or nothing is missing",
    "impossible": "the values that fit best are physically impossible",
}


def diagnose(memory: CaseMemory, task: Task, folder: Path, progress: Progress) -> None:
    """Write the diagnosis, its rows with the present and the improved model, and its pictures."""
    details = memory.diagnosis(task, lambda share, stage: progress(0.9 * share, stage))
    dataset, vehicle, catalogue = memory.dataset(task), memory.vehicle(task), memory.catalogue(task)
    noise = details.noise
    progress(0.9, "pictures")
    before = residuals_in(noise, details.likelihood.vehicle_without, dataset.everything)
    after = residuals_in(noise, details.accepted.fit.vehicle, dataset.everything)
    floor = noise.floor
    maps = regime_maps(dataset.everything, before, floor, vehicle, DEFAULT.regimes)
    improved = regime_maps(dataset.everything, after, floor, vehicle, DEFAULT.regimes)
    rows = write_rows(folder, task, dataset, vehicle, floor, maps, {"residual": before, "improved": after})
    spectra = [residual_spectrum(r, noise) for r in (before, after)]
    intervals = pictures.interval_lines(details.diagnosis)
    shown = {
        "bars": pictures.channel_bars(details.diagnosis.channels),
        "ranking": pictures.ranking_bars(details),
        "spectrum": pictures.spectrum_lines(spectra[0], spectra[1] if details.diagnosis.effects else None),
        "regimes": regions.regime_map(maps),
        "regimes_after": regions.regime_map(improved),
        "likeness": pictures.likeness_map(likeness(details)),
        **({} if intervals is None else {"intervals": intervals}),
        **{
            f"{FOLLOWED}{place}": followed_picture(flight, effects_of(flight, details.diagnosis))
            for place, flight in enumerate(details.followed)
        },
    }
    diagnosis = details.diagnosis
    result = Diagnosed(
        diagnosis=diagnosis,
        sentence=sentence(diagnosis),
        notes=details.notes,
        leftovers=tuple(f"{leftover_sentence(left)}. {evidence_sentence(left)}" for left in diagnosis.leftover),
        ranking=_ranking(details, catalogue),
        addable=tuple(e.name for e in diagnosis.effects if not catalogue[e.name].stochastic),
        rows=rows,
        pictures={name: picture_info(picture) for name, picture in shown.items()},
    )
    write_json(result, folder / FILES[Diagnosed])


def _ranking(details: DiagnosisDetails, catalogue: Mapping[str, Effect]) -> tuple[RankedEffect, ...]:
    """Candidates that were tried: effects that are named first, then the others by their score."""
    diagnosis = details.diagnosis
    order = {"named": 0, "refused": 1}
    ranked = [_ranked(item, diagnosis, catalogue) for item in diagnosis.candidates]
    return tuple(sorted(ranked, key=lambda one: order.get(one.outcome, 2)))


def _ranked(item: Considered, diagnosis: Diagnosis, catalogue: Mapping[str, Effect]) -> RankedEffect:
    effect = catalogue[item.name]
    identity = item.name, item.rotor
    refusal = next((r for r in diagnosis.refused if (r.name, r.rotor) == identity), None)
    named = next((e for e in diagnosis.effects if (e.name, e.rotor) == identity), None)
    value = ""
    if named is not None:
        value = ", ".join(
            f"{name} {p.value:.4g}" + (f" ± {1.96 * p.std:.2g}" if p.std else "") + f" {unit_shown(p.unit)}".rstrip()
            for name, p in named.parameters.items()
        )
    elif refusal is not None:
        value = ", ".join(f"{name} {number:.4g}" for name, number in refusal.parameters.items())
    return RankedEffect(
        key=item.name if item.rotor is None else f"{item.name}[{item.rotor}]",
        summary=effect.summary,
        score=item.score,
        outcome=item.outcome,
        reason=OUTCOMES.get(item.outcome, "") if refusal is None else reason_of(refusal),
        value=value,
        own=item.name not in CATALOGUE,
    )
