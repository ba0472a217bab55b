"""Windows to compare backends on: from logs, along the paper's references, and at random."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import msgspec
import numpy as np

from dynamics import quaternion
from dynamics.arrays import Floats
from dynamics.references import named_reference
from dynamics.state import ATTITUDE, RIGID_BODY_STATES
from dynamics.vehicle import Vehicle
from export.trained import ExportedModel
from training.data.labelled_rows import label_rows, with_logged_motors
from training.data.logged_flights import find_logs, read_logged_flights

REFERENCES = ("Lemniscate", "TransposedParabola", "WarpedEllipse_1")
SPEED_NOISE = 0.05  # of hover speed: references have smoother rotor speeds than any controller's


def recorded_windows(model: ExportedModel, logs: Sequence[Path], count: int, seed: int) -> Floats:
    """(count or fewer, 13 + rotors, `model.window`) windows of logs. Raises DataError without any."""
    vehicle = model.vehicle
    recordings = read_logged_flights(find_logs(logs), dt=model.config.dt, may_be_tests=True)
    config = msgspec.structs.replace(with_logged_motors(model.config, recordings, vehicle), history=model.window)
    data = label_rows(config, vehicle, recordings, min_windows=1)
    columns = np.hstack([data.state, data.rotor_speed])
    chosen = np.random.default_rng(seed).permutation(data.ends)[:count]
    return np.asarray(columns[chosen[:, None] + np.arange(1 - model.window, 1)].transpose(0, 2, 1))


def reference_windows(model: ExportedModel, count: int, seed: int) -> Floats:
    """(count, 13 + rotors, `model.window`) windows along the paper's manoeuvres, with noise on the rotor speeds."""
    rng = np.random.default_rng(seed)
    parts = []
    for place, name in enumerate(REFERENCES):
        reference = named_reference(name, model.vehicle)
        number = count // len(REFERENCES) + (place < count % len(REFERENCES))
        starts = rng.uniform(0, reference.duration - model.window * model.config.dt, number)
        times = (starts[:, None] + model.config.dt * np.arange(model.window)).ravel()
        speeds = reference.inputs(times) + SPEED_NOISE * model.vehicle.hover_speed * rng.normal(
            size=(times.size, model.vehicle.rotors.count)
        )
        columns = np.hstack([reference.states(times), _within(speeds, model.vehicle)])
        parts.append(columns.reshape(number, model.window, -1).transpose(0, 2, 1))
    return np.concatenate(parts)


def random_windows(model: ExportedModel, count: int, seed: int) -> Floats:
    """(count, 13 + rotors, `model.window`) windows of independent columns."""
    rng = np.random.default_rng(seed)
    rotors = model.vehicle.rotors.count
    scale = np.array([1.0] * 3 + [4.0] * 3 + [0.5] * 4 + [4.0] * 3 + [0.2 * model.vehicle.hover_speed] * rotors)
    windows = rng.normal(size=(count, model.window, RIGID_BODY_STATES + rotors)) * scale
    windows[..., 2] += 3
    windows[..., ATTITUDE.start] += 1
    windows[..., ATTITUDE] = quaternion.normalise(windows[..., ATTITUDE])
    speeds = windows[..., RIGID_BODY_STATES:] + model.vehicle.hover_speed
    windows[..., RIGID_BODY_STATES:] = _within(speeds, model.vehicle)
    return np.asarray(windows.transpose(0, 2, 1))


def _within(speeds: Floats, vehicle: Vehicle) -> Floats:
    return np.asarray(np.clip(speeds, vehicle.rotors.speed_min, vehicle.rotors.speed_max))
