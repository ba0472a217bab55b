"""The rows of a data set as a page draws them: measured channels, residuals, place, and the cells that they lie in."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from diagnosis.data.dataset import Dataset
from diagnosis.data.segment import Segment
from diagnosis.models import channels
from diagnosis.regimes import Regime, row_quantities
from diagnosis.thresholds import DEFAULT
from dynamics.arrays import Floats
from dynamics.vehicle import Vehicle
from studio.pages.figure import Picture
from studio.work.arrays import write_arrays
from studio.work.results import PictureInfo, QuantityInfo, Rows, SegmentInfo
from studio.work.task import Task


def write_rows(
    folder: Path,
    task: Task,
    dataset: Dataset,
    vehicle: Vehicle,
    floor: Floats,
    maps: Sequence[Regime],
    residuals: Mapping[str, Sequence[Floats]],
) -> Rows:
    """Write the rows' tables, and say what they are.

    floor: (12,). maps: whose cells the rows lie in. residuals: (m, 12) of each segment, by the name of their model.
    """
    segments = dataset.everything
    values = row_quantities(segments, vehicle, DEFAULT.regimes)
    arrays: dict[str, NDArray[Any]] = {
        "time": np.concatenate([_times(segment) for segment in segments]),
        "position": np.vstack([segment.position[segment.decimated] for segment in segments]).astype(np.float32),
        "measured": np.vstack([channels.measured(segment) for segment in segments]).astype(np.float32),
        "quantities": np.array([values[regime.name] for regime in maps], dtype=np.float32),
    }
    arrays |= {name: np.vstack(parts).astype(np.float32) for name, parts in residuals.items()}
    write_arrays(folder, arrays)
    return Rows(
        segments=tuple(_infos(task, dataset)),
        rate=segments[0].decimated_rate,
        floor=floor.tolist(),
        quantities=tuple(QuantityInfo(regime.name, regime.edges.tolist()) for regime in maps),
    )


def picture_info(picture: Picture) -> PictureInfo:
    """A picture as JSON holds it."""
    return PictureInfo(picture.data, picture.height, picture.description)


def _times(segment: Segment) -> Floats:
    return np.asarray(segment.start + np.arange(len(segment))[segment.decimated] / segment.rate)


def _infos(task: Task, dataset: Dataset) -> list[SegmentInfo]:
    places = {path: number for number, path in enumerate(task.logs)}
    infos, first = [], 0
    for number, segment in enumerate(dataset.everything):
        stop = first + len(channels.measured(segment))
        infos.append(
            SegmentInfo(
                flight=Path(segment.flight).name,
                log=places.get(segment.flight, 0),
                start=float(_times(segment)[0]),
                first=first,
                stop=stop,
                held_out=number >= len(dataset.fitted),
            )
        )
        first = stop
    return infos
