"""Flights as a network learns them: one table of all rows, and the rows at which a window may end."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import msgspec
import numpy as np
from numpy.typing import NDArray

from dynamics import quaternion
from dynamics.arrays import Floats
from dynamics.errors import DataError
from dynamics.state import ATTITUDE
from dynamics.vehicle import Vehicle
from flights.flight import Flight
from flights.rotors import rotor_speeds
from training.config import ModelConfig, Motors
from training.data.features import body_accelerations, columns, outputs_from, world_accelerations
from training.data.labels import Samples, as_labelled, paper_table, samples
from training.data.logged_flights import LoggedFlight
from training.data.windows import window_ends
from training.physics import RowModel, nominal_model
from training.vehicle_fit import require_fit

MIN_WINDOWS = 500


@dataclass(frozen=True, eq=False)
class RowNames:
    """Flight and time of each row.

    flights: names of the flights.
    flight_of: (n,) index into `flights`.
    time: (n,) s of the flight's own clock.
    """

    flights: tuple[str, ...]
    flight_of: NDArray[np.intp]
    time: Floats

    def flight_at(self, row: int) -> str:
        """Name of the flight that a row belongs to."""
        return self.flights[int(self.flight_of[row])]


@dataclass(frozen=True, eq=False)
class LabelledRows:
    """All rows of some flights, one after the other; accelerations are body accelerations (`training.data.features`).

    flights: names of the flights.
    time: (n,) s of the flight's own clock.
    flight_of: (n,) index into `flights`.
    state: (n, 13), zeros for a position that the flight does not have.
    rotor_speed: (n, rotors) rad/s.
    label: (n, 6) measured accelerations.
    nominal: (n, 6) accelerations of the nominal model.
    base: (n, 6) accelerations of what the network adds to, None for none.
    base_labelled: (n, 6) the base after the labels' filters, None for none.
    inputs: (n, k) columns.
    targets: (n, 6) outputs that the network should give: with base_labelled they make the label.
    ends: (m,) rows with T columns before them and a label.
    """

    flights: tuple[str, ...]
    time: Floats
    flight_of: NDArray[np.intp]
    state: Floats
    rotor_speed: Floats
    label: Floats
    nominal: Floats
    base: Floats | None
    base_labelled: Floats | None
    inputs: Floats
    targets: Floats
    ends: NDArray[np.intp]

    @property
    def names(self) -> RowNames:
        """Flight and time of every row."""
        return RowNames(self.flights, self.flight_of, self.time)


def with_logged_motors(config: ModelConfig, recordings: Sequence[LoggedFlight], vehicle: Vehicle) -> ModelConfig:
    """The definition with the kind of rotor speeds that these flights log: its own kind, unless no flight logs it.

    Raises DataError when the flights differ, or one has no motor data.
    """
    names: dict[Motors, str] = {}
    for recording in recordings:
        _, source = rotor_speeds(recording.segments[0], vehicle, prefer=config.motors)
        names["measured" if source == "measured" else "command"] = recording.name
    if len(names) > 1:
        raise DataError(
            f"{names['command']} has motor commands, {names['measured']} measured rotor speeds only: a network cannot "
            f"learn from both. Give --motors {'measured' if config.motors == 'command' else 'command'}, or flights of "
            "one kind."
        )
    return msgspec.structs.replace(config, motors=next(iter(names)))


def label_rows(
    config: ModelConfig, vehicle: Vehicle, recordings: Sequence[LoggedFlight], *, min_windows: int = MIN_WINDOWS
) -> LabelledRows:
    """Inputs, labels and models over all flights.

    min_windows: minimum number of windows to learn from or to evaluate on.

    Raises DataError when motors or motion are missing, there are too few windows, or the vehicle file does not fit.
    """
    nominal = nominal_model(vehicle, dt=config.dt, label=config.label)
    grey_box = config.base == "grey_box"
    model = RowModel(vehicle, vehicle.effects, dt=config.dt, label=config.label, motors=config.motors)
    parts = [
        _segment(config, vehicle, segment, nominal, model if grey_box else nominal, place)
        for place, recording in enumerate(recordings)
        for segment in recording.segments
    ]
    table = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    ends = window_ends([part["inputs"] for part in parts], config.history)
    ends = ends[np.isfinite(table["targets"][ends]).all(axis=1)]
    names = tuple(recording.name for recording in recordings)
    if len(ends) < min_windows:
        raise DataError(
            f"{', '.join(names[:4])}: {len(ends)} windows of {config.history} rows without a gap in inputs and label. "
            f"Required: at least {min_windows}, {min_windows * config.dt:g} s of flight; `alula inspect` lists gaps."
        )
    dataset = LabelledRows(
        flights=names, time=table["time"], flight_of=table["flight_of"].astype(np.intp),
        state=table["state"], rotor_speed=table["rotor_speed"], label=table["label"], nominal=table["nominal"],
        base=None if config.base == "none" else table["base"],
        base_labelled=None if config.base == "none" else table["base_labelled"], inputs=table["inputs"],
        targets=table["targets"], ends=ends,
    )  # fmt: skip
    of_flight = [ends[dataset.flight_of[ends] == place] for place in range(len(names))]
    require_fit(
        vehicle, [(name, dataset.label[at], dataset.nominal[at]) for name, at in zip(names, of_flight, strict=True)]
    )
    return dataset


def _segment(
    config: ModelConfig, vehicle: Vehicle, segment: Flight, nominal: RowModel, base: RowModel, place: int
) -> dict[str, Floats]:
    speeds, _ = rotor_speeds(segment, vehicle, prefer=config.motors)
    with_speeds = Flight(segment.time, {**segment.values, "rotor_speed": speeds}, segment.provenance)
    rows = _samples(config, with_speeds)
    attitude = rows.state[:, ATTITUDE]
    nominal_body = nominal(rows.state, rows.rotor_speed).body
    base_body = nominal_body if base is nominal else base(rows.state, rows.rotor_speed).body
    base_labelled = labelled(config, base_body, attitude)
    label = body_accelerations(rows.label, attitude)
    targets = outputs_from(config, vehicle, label, None if config.base == "none" else base_labelled, attitude)
    return {
        "time": rows.time,
        "flight_of": np.full(len(segment), float(place)),
        "state": rows.state,
        "rotor_speed": rows.rotor_speed,
        "label": label,
        "nominal": nominal_body,
        "base": base_body,
        "base_labelled": base_labelled,
        "inputs": columns(config, rows.state, rows.rotor_speed),
        "targets": targets,
    }


def labelled(config: ModelConfig, body: Floats, attitude: Floats) -> Floats:
    """A base's body accelerations (n, 6) after the filters of the labels, for a grey box; otherwise as they are.

    If effects were subtracted unfiltered from smooth labels, the residual would cancel their fast response to the
    rotors. The nominal model's response lacks the rotors' lag, so that there the residual should cancel it.

    attitude: (n, 4).
    """
    if config.filtered_inputs or config.base != "grey_box":  # the response to filtered inputs is smooth already
        return body
    world = as_labelled(world_accelerations(body, attitude), 1 / config.dt, paper=config.label == "instantaneous")
    return body_accelerations(world, attitude)


def _samples(config: ModelConfig, segment: Flight) -> Samples:
    """Inputs and labels of a segment; filtered inputs and instantaneous labels are the paper's, independent options.

    The attitude's w is positive at the start of a segment and continuous from there on.
    """
    filtered = config.filtered_inputs, config.label == "instantaneous"
    paper = paper_table(segment) if any(filtered) else None
    causal = samples(segment, horizon=config.dt) if not all(filtered) else None
    inputs = paper if config.filtered_inputs else causal
    labels = paper if config.label == "instantaneous" else causal
    assert inputs is not None
    assert labels is not None
    state = inputs.state.copy()
    attitude = quaternion.normalise(quaternion.continuous(state[:, ATTITUDE]))
    state[:, ATTITUDE] = attitude if not attitude[0, 0] < 0 else -attitude
    return Samples(inputs.time, state, inputs.rotor_speed, labels.label)
