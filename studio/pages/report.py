"""The pages of compare, diagnose and demo, each one self-contained HTML file."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from diagnosis.comparison import ComparisonDetails
from diagnosis.data.dataset import Dataset
from diagnosis.diagnose import DiagnosisDetails
from diagnosis.estimation.evaluation import residuals_in
from diagnosis.models.channels import NAMES
from diagnosis.regimes import regime_maps, regime_planes
from diagnosis.report import Diagnosis, in_flight_sentence, sentence
from diagnosis.spectrum import residual_spectrum
from dynamics.effect import Effect
from dynamics.effects import CATALOGUE
from dynamics.vehicle import Vehicle
from studio.pages import diagnosed as pictures
from studio.pages import flown as flown_pictures
from studio.pages import regions
from studio.pages.evidence import agreement, likeness, overlay
from studio.pages.figure import Picture
from studio.pages.flown import FlownComparison
from studio.pages.followed import effects_of, followed_picture
from studio.pages.page import Origin, render


def diagnosis_pictures(result: DiagnosisDetails, dataset: Dataset, vehicle: Vehicle) -> dict[str, Picture]:
    """The pictures of `diagnosis_page` by name. vehicle: with the model that was judged."""
    return _pictures(_diagnosed(result, dataset, vehicle))


def comparison_pictures(compared: ComparisonDetails, dataset: Dataset) -> dict[str, Picture]:
    """The pictures of `comparison_page` by name."""
    return _pictures(_compared(compared, dataset))


def _pictures(content: Mapping[str, Any]) -> dict[str, Picture]:
    """The pictures of a page's content; several of one name are numbered."""
    named: dict[str, Picture] = {}
    for name, value in content.items():
        if isinstance(value, Picture):
            named[name] = value
        elif isinstance(value, list):
            several = [one for one in value if isinstance(one, Picture)]
            named |= {f"{name}_{place}": one for place, one in enumerate(several, start=1)}
    return named


def diagnosis_page(result: DiagnosisDetails, dataset: Dataset, vehicle: Vehicle, *, origin: Origin) -> str:
    """The page of `alula diagnose --html`. vehicle: with the model that was judged."""
    return render(
        "diagnosis.html",
        title=f"What the model of {vehicle.name} misses",
        origin=origin,
        vehicle=vehicle,
        **_diagnosed(result, dataset, vehicle),
    )


def comparison_page(compared: ComparisonDetails, dataset: Dataset, vehicle: Vehicle, *, origin: Origin) -> str:
    """The page of `alula compare --html`."""
    return render(
        "comparison.html",
        title=f"The model of {vehicle.name} against its flights",
        origin=origin,
        vehicle=vehicle,
        **_compared(compared, dataset),
    )


def demo_page(
    flown: Sequence[FlownComparison],
    result: DiagnosisDetails,
    dataset: Dataset,
    *,
    origin: Origin,
    hidden: Sequence[str] = (),
) -> str:
    """The demo's page: tracking and prediction error before and after, the flights, and the diagnosis between them.

    result, dataset: of the first flights. hidden: what the simulated vehicle hid, in words.
    """
    views = [(item, flown_pictures.flight_view(item), flown_pictures.flight_in_space(item)) for item in flown]
    vehicle = result.noise.vehicle
    return render(
        "demo.html",
        title="Alula demo: the model before and after diagnosis",
        origin=origin,
        flown=flown,
        tracking=flown_pictures.tracking_bars(flown) if flown else None,
        views=views,
        hidden=hidden,
        vehicle=vehicle,
        **_diagnosed(result, dataset, vehicle),
    )


def add_command(
    diagnosis: Diagnosis,
    logs: Sequence[Path],
    vehicle: str,
    options: Mapping[str, str | Path | Sequence[str | Path] | bool | None],
    catalogue: Mapping[str, Effect] = CATALOGUE,
) -> str:
    """The command that adds what a diagnosis names and a vehicle file can hold, empty where there is nothing.

    options: of the diagnosis, by name; None or nothing where an option was not used. The same data then lead to the
    same effects, each on its own rotor.
    """
    if all(catalogue[effect.name].stochastic for effect in diagnosis.effects):
        return ""
    words = ["alula", "add", *map(str, logs), "--vehicle", vehicle]
    for name, value in options.items():
        if isinstance(value, bool):
            words += [name] * value
            continue
        values = [value] if isinstance(value, str | Path) else value or []
        words += [word for one in values for word in (name, str(one))]
    return shlex.join(words)


def _compared(compared: ComparisonDetails, dataset: Dataset) -> dict[str, Any]:
    """Content of the page of a comparison."""
    rows = compared.residuals
    view = overlay(dataset.everything, rows, rows, compared.noise)
    both = agreement(rows)
    return {
        "compared": compared.comparison,
        "names": NAMES,
        "bars": pictures.axis_bars(compared.comparison.axes),
        "view": view,
        "lines": pictures.overlay_lines(view, improved=False),
        "regimes": regions.regime_map(compared.maps),
        "planes": [regions.plane_map(plane) for plane in compared.planes],
        "spectrum": pictures.spectrum_lines(compared.spectrum, None),
        "agreement": None if both is None else pictures.agreement_points(both),
    }


def _diagnosed(result: DiagnosisDetails, dataset: Dataset, vehicle: Vehicle) -> dict[str, Any]:
    """Content of the sections on a diagnosis."""
    noise = result.noise
    floor, thresholds = noise.floor, noise.thresholds
    rows = [*residuals_in(noise, result.likelihood.vehicle_without, noise.segments), *result.before]
    improved = bool(result.diagnosis.effects)
    view = overlay(dataset.held_out, result.before, result.after, noise)
    both = agreement(rows)
    after = residual_spectrum(result.after, noise) if improved else None
    maps = regime_maps(dataset.everything, rows, floor, vehicle, thresholds.regimes)
    planes = regime_planes(dataset.everything, rows, floor, vehicle, thresholds.regimes)
    return {
        "diagnosis": result.diagnosis,
        "sentence": sentence(result.diagnosis),
        "notes": result.notes,
        "names": NAMES,
        "bars": pictures.channel_bars(result.diagnosis.channels),
        "view": view,
        "lines": pictures.overlay_lines(view, improved=improved),
        "regimes": regions.regime_map(maps),
        "planes": [regions.plane_map(plane) for plane in planes],
        "ranking": pictures.ranking_bars(result),
        "intervals": pictures.interval_lines(result.diagnosis),
        "spectrum": pictures.spectrum_lines(residual_spectrum(result.before, noise), after),
        "agreement": None if both is None else pictures.agreement_points(both),
        "likeness": pictures.likeness_map(likeness(result)),
        "in_flight": [in_flight_sentence(one, result.diagnosis.rotors) for one in result.diagnosis.in_flight],
        "followed": [followed_picture(flight, effects_of(flight, result.diagnosis)) for flight in result.followed],
    }
