"""A model against flights: error of each channel over its noise floor, where it fails, and how fast it diverges."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import msgspec
import numpy as np

from diagnosis.by_likelihood import noise_of
from diagnosis.data.data_checks import require_answerable
from diagnosis.data.dataset import Dataset
from diagnosis.data.segment import Segment
from diagnosis.estimation.channel_noise import ChannelNoise
from diagnosis.estimation.evaluation import floor_norms, residuals
from diagnosis.models import channels
from diagnosis.models.open_loop import HorizonError, open_loop_errors
from diagnosis.one_thread import one_thread
from diagnosis.regimes import (
    Failure,
    Plane,
    PlaneCells,
    Regime,
    RegimeCells,
    plane_cells,
    regime_cells,
    regime_maps,
    regime_planes,
    worst_cells,
)
from diagnosis.spectrum import Spectrum, SpectrumLines, residual_spectrum, spectrum_lines
from diagnosis.thresholds import DEFAULT, Thresholds
from dynamics.arrays import Floats
from dynamics.effect import Effect
from dynamics.vehicle import Vehicle


class AxisError(msgspec.Struct, frozen=True):
    """RMS error of one channel, its floor, and the noise of the sensors alone, as for `ChannelError`."""

    kind: str
    axis: str
    rms: float
    floor: float
    unit: str
    sensors: float


class WorstSeconds(msgspec.Struct, frozen=True):
    """The window of all flights with the greatest error over floor. start: s in the log's time."""

    flight: str
    start: float
    rms_over_floor: float


class Comparison(msgspec.Struct, frozen=True):
    """Document that `alula compare --json` writes."""

    axes: tuple[AxisError, ...]
    fails_where: tuple[Failure, ...]
    worst: WorstSeconds
    open_loop: tuple[HorizonError, ...]
    notes: tuple[str, ...]
    maps: tuple[RegimeCells, ...]
    planes: tuple[PlaneCells, ...]
    spectrum: SpectrumLines


@dataclass(frozen=True, eq=False)
class ComparisonDetails:
    """A comparison and what pictures of it need.

    comparison: the answer.
    residuals: (m, 12) of each segment.
    maps, planes: where the model fails.
    spectrum: of the residuals.
    noise: of the fitted flights.
    """

    comparison: Comparison
    residuals: list[Floats]
    maps: tuple[Regime, ...]
    planes: tuple[Plane, ...]
    spectrum: Spectrum
    noise: ChannelNoise


@one_thread
def compare_dataset(
    dataset: Dataset, vehicle: Vehicle, catalogue: Mapping[str, Effect], thresholds: Thresholds = DEFAULT
) -> ComparisonDetails:
    """Compare a vehicle's model with all flights of a data set. Raises DataError when they cannot answer.

    thresholds: all but those that are applied when flights are read.
    """
    segments = dataset.everything
    require_answerable(segments, vehicle, thresholds)
    noise = noise_of(dataset, vehicle, catalogue, thresholds)
    rows = residuals(vehicle, catalogue, segments, thresholds=thresholds)
    floor = noise.floor
    maps = regime_maps(segments, rows, floor, vehicle, thresholds.regimes)
    planes = regime_planes(segments, rows, floor, vehicle, thresholds.regimes)
    spectrum = residual_spectrum(rows, noise)
    comparison = Comparison(
        axes=_axes(rows, noise.floor_of(rows), noise.sensors),
        fails_where=worst_cells(maps, thresholds.regimes),
        worst=_worst(segments, rows, noise),
        open_loop=open_loop_errors(vehicle, catalogue, segments, thresholds.prediction),
        notes=dataset.notes,
        maps=tuple(map(regime_cells, maps)),
        planes=tuple(map(plane_cells, planes)),
        spectrum=spectrum_lines(spectrum),
    )
    return ComparisonDetails(comparison, rows, maps, planes, spectrum, noise)


def _axes(rows: Sequence[Floats], floor: Floats, sensors: Floats) -> tuple[AxisError, ...]:
    rms, by_kind = np.sqrt(np.mean(np.vstack(rows) ** 2, axis=0)), floor_norms(floor)
    return tuple(
        AxisError(
            kind=kind,
            axis="xyz"[axis],
            rms=float(rms[3 * k + axis]),
            floor=float(floor[3 * k + axis]),
            unit=channels.UNITS[kind],
            sensors=float(min(sensors[3 * k + axis], floor[3 * k + axis])),
        )
        for k, kind in enumerate(channels.KINDS)
        if by_kind[kind] > 0
        for axis in range(channels.AXES)
    )


def worst_window(
    rows: Sequence[Floats], floor: Floats, rate: float, duration: float = DEFAULT.regimes.worst_window
) -> tuple[int, int, float]:
    """Segment and first row of the window with the greatest error over floor, and that error.

    rows: (m, 12) residuals of each segment at rate Hz. floor: (12,). duration: of the window, s.
    """
    count, active = max(1, round(duration * rate)), floor > 0
    windows = []
    for index, r in enumerate(rows):
        squared = np.mean((r[:, active] / floor[active]) ** 2, axis=1)
        mean = np.convolve(squared, np.ones(count) / count, mode="valid") if len(squared) >= count else squared
        place = int(np.argmax(mean))
        windows.append((index, place, float(np.sqrt(mean[place]))))
    return max(windows, key=lambda window: window[2])


def _worst(segments: Sequence[Segment], rows: Sequence[Floats], noise: ChannelNoise) -> WorstSeconds:
    duration = noise.thresholds.regimes.worst_window
    index, place, level = worst_window(rows, noise.floor, noise.rate, duration)
    segment = segments[index]
    return WorstSeconds(segment.flight, round(float(segment.decimated_times[place]), 2), round(level, 2))
