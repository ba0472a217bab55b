"""Ground truth of a simulated campaign: the increments that labels estimate, and the plant that flew."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from dynamics.arrays import Floats
from dynamics.decoding import decode_json
from dynamics.errors import DataError
from dynamics.field_errors import described
from dynamics.own_effects import catalogue_of
from dynamics.rate_loop import with_motor_lag
from dynamics.state import ATTITUDE, RIGID_BODY_STATES
from dynamics.vehicle import Vehicle
from dynamics.vehicle_file import parse_effect
from flights.flight import Flight
from flights.folder import CAMPAIGN
from training.data.features import body_accelerations
from training.data.labelled_rows import LabelledRows
from training.data.labels import mean_increment

FOLDER = "truth"  # of a campaign


def campaign_of(logs: tuple[Path, ...]) -> Path | None:
    """The folder of the campaign that all these flights are of, None when they are of none or of several."""
    folders = {path.resolve().parent.parent for path in logs}
    if len(folders) != 1:
        return None
    folder = folders.pop()
    return folder if (folder / CAMPAIGN).exists() and (folder / FOLDER).is_dir() else None


def hidden_plant(campaign: Path, vehicle: Vehicle) -> Vehicle:
    """The vehicle that really flew: body and rotors of the file with what the campaign hid, and every motor's lag.

    Noise is left out.

    Raises DataError when the campaign does not name what it hid.
    """
    path = campaign / CAMPAIGN
    try:
        manifest: dict[str, Any] = decode_json(path.read_bytes())
        texts = [str(text) for text in manifest["effects"]]
    except (OSError, KeyError, TypeError, msgspec.MsgspecError) as error:
        raise DataError(f"{path} does not name what the campaign hid: {described(error)}. Fly it again.") from error
    catalogue = catalogue_of(vehicle)
    uses = [parse_effect(text, vehicle.rotors.count, catalogue=catalogue) for text in texts]
    bare = msgspec.structs.replace(vehicle, effects=())
    return bare.with_effects(*with_motor_lag([use for use in uses if not catalogue[use.name].stochastic], catalogue))


def true_label(data: LabelledRows, campaign: Path, *, dt: float) -> Floats:
    """(n, 6) true mean body accelerations over the next dt at the rows of a campaign's flights; NaN at their ends.

    Raises DataError when the campaign has no ground truth of one of the flights.
    """
    label = np.full((len(data.time), 6), np.nan)
    for part in _true_flights(data, campaign, dt):
        increments = mean_increment(np.hstack([part.flight["velocity"], part.flight["rate"]]), 1 / dt, dt)
        inside = part.at < len(increments)
        rows = part.rows[inside]
        label[rows] = body_accelerations(increments[part.at[inside]], data.state[rows, ATTITUDE])
    return label


def true_states(data: LabelledRows, campaign: Path, *, dt: float) -> Floats:
    """(n, 13) true states at the rows of a campaign's flights; NaN where there is none. Raises DataError likewise."""
    states = np.full((len(data.time), RIGID_BODY_STATES), np.nan)
    for part in _true_flights(data, campaign, dt):
        inside = part.at < len(part.flight)
        names = ("position", "velocity", "attitude", "rate")
        states[part.rows[inside]] = np.hstack([part.flight[name][part.at[inside]] for name in names])
    return states


@dataclass(frozen=True, eq=False)
class _TrueFlight:
    """The ground truth of one flight.

    flight: the true motion.
    rows: (m,) rows of the data set.
    at: (m,) the same instants in the flight.
    """

    flight: Flight
    rows: NDArray[np.intp]
    at: NDArray[np.intp]


def _true_flights(data: LabelledRows, campaign: Path, dt: float) -> Iterator[_TrueFlight]:
    for place, name in enumerate(data.flights):
        path = campaign / FOLDER / name
        if not path.exists():
            raise DataError(f"{path} is missing: errors against the truth need a campaign's own flights and folder.")
        flight = Flight.read(path, rate=1 / dt)
        rows = np.flatnonzero(data.flight_of == place)
        yield _TrueFlight(flight, rows, np.searchsorted(flight.time, data.time[rows] - 0.25 * dt))
