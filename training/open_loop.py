"""How far a model strays when it runs by itself: open-loop errors, and its response to a pulse on the rotors."""

from __future__ import annotations

import msgspec
import numpy as np
from numpy.typing import NDArray

from dynamics import quaternion
from dynamics.arrays import Floats
from dynamics.state import ATTITUDE, POSITION, RATE, VELOCITY
from dynamics.units import RPM
from training.checkpoint import TrainedModel
from training.data.dataset import Dataset
from training.free_run import Simulation, warm_up

HORIZONS = (0.1, 0.5, 1.0)  # s
APART = 0.25  # s between starts of open-loop predictions
PULSE = 200 * RPM
PULSE_STEPS, RESPONSE_STEPS = 1, 10  # of dt: 10 ms of pulse, read after 100 ms
PULSE_STARTS = 200  # at most, spread over the flights


class OpenLoop(msgspec.Struct, frozen=True):
    """RMS distance after `horizon` s: position m, velocity m/s, attitude rad, body rates rad/s."""

    horizon: float
    position: float
    velocity: float
    attitude: float
    rate: float


class Pulse(msgspec.Struct, frozen=True):
    """Error of the response to +200 rpm for 10 ms, over the response itself, 100 ms after it began.

    name: which rotors. rate: of body rates, None for all rotors, which hardly turn it. velocity: of velocity. thrust:
    of velocity along body z alone.
    """

    name: str
    rate: float | None
    velocity: float
    thrust: float


def open_loop(model: TrainedModel, data: Dataset, wanted: Floats) -> tuple[OpenLoop, ...]:
    """Errors of the model run from recorded states with recorded motors.

    wanted: (n, 13) states that are compared with, NaN where unknown. Empty when no segment is long enough.
    """
    dt = model.config.dt
    steps = [round(horizon / dt) for horizon in HORIZONS]
    rows = starts(model, data, ahead=steps[-1])[:: max(1, round(APART / dt))]
    rows = rows[np.isfinite(wanted[rows[:, None] + np.array([0, *steps])]).all(axis=(1, 2))]
    if not len(rows):
        return ()
    simulation, found = _begun(model, data, rows), []
    for step in range(1, steps[-1] + 1):
        simulation.step(data.rotor_speed[rows + step - 1])
        if step in steps:
            error = simulation.state - wanted[rows + step]
            angle = quaternion_angle(simulation.state[:, ATTITUDE], wanted[rows + step, ATTITUDE])
            parts = error[:, POSITION], error[:, VELOCITY], angle[:, None], error[:, RATE]
            found.append(OpenLoop(step * dt, *(rms(part) for part in parts)))
    return tuple(found)


def pulse_responses(model: TrainedModel, plant: TrainedModel, data: Dataset) -> tuple[Pulse, ...]:
    """The model's response to pulses on single rotors and on all of them, against the plant's from the same states."""
    rows = starts(model, data, ahead=RESPONSE_STEPS)
    rows = rows[:: max(1, len(rows) // PULSE_STARTS)]
    if not len(rows):
        return ()
    rotors = data.rotor_speed.shape[1]
    single = [_error(model, plant, data, rows, np.eye(rotors)[rotor]) for rotor in range(rotors)]
    collective = _error(model, plant, data, rows, np.ones(rotors))
    return (
        Pulse("one rotor", *np.sqrt(np.mean(np.square(single), axis=0)).tolist()),
        Pulse("all rotors", None, *collective[1:]),
    )


def starts(model: TrainedModel, data: Dataset, *, ahead: int) -> NDArray[np.intp]:
    """Rows with enough columns before them, and `ahead` rows after them, in one segment without a gap."""
    behind = warm_up(model.config) - 1
    rows = np.arange(behind, len(data.time) - ahead)
    known = np.asarray(np.isfinite(np.hstack([data.state, data.rotor_speed])).all(axis=1))
    broken = np.concatenate([[0], np.cumsum(~known | _begins(data))])
    # a segment's first row may be the oldest column, so it does not count as a break of the window that begins there
    whole = broken[rows + ahead + 1] - broken[rows - behind + 1] == 0
    begun: NDArray[np.intp] = rows[np.logical_and(whole, known[rows - behind])]
    return begun


def _begins(data: Dataset) -> NDArray[np.bool_]:
    """(n,) rows that do not follow the one before them."""
    period = float(np.median(np.diff(data.time)))
    begins = np.ones(len(data.time), dtype=bool)
    begins[1:] = (np.diff(data.flight_of) != 0) | (np.abs(np.diff(data.time) - period) > 0.5 * period)
    return begins


def _begun(model: TrainedModel, data: Dataset, rows: NDArray[np.intp]) -> Simulation:
    window = rows[:, None] + np.arange(1 - warm_up(model.config), 1)
    return Simulation(model, data.state[window], data.rotor_speed[window[:, :-1]])


def _error(
    model: TrainedModel, plant: TrainedModel, data: Dataset, rows: NDArray[np.intp], which: Floats
) -> tuple[float, float, float]:
    said, true = (_response(one, data, rows, PULSE * which) for one in (model, plant))
    up = quaternion.rotate(data.state[rows, ATTITUDE], np.broadcast_to([0.0, 0.0, 1.0], (len(rows), 3)))
    along, true_along = (np.sum(value[:, :3] * up, axis=1, keepdims=True) for value in (said, true))
    parts = ((said[:, 3:], true[:, 3:]), (said[:, :3], true[:, :3]), (along, true_along))
    rate, velocity, thrust = (rms(one - other) / max(rms(other), 1e-300) for one, other in parts)
    return rate, velocity, thrust


def _response(model: TrainedModel, data: Dataset, rows: NDArray[np.intp], pulse: Floats) -> Floats:
    """(m, 6) what a pulse has changed in velocity and body rates."""
    simulations = [_begun(model, data, rows) for _ in range(2)]
    for step in range(RESPONSE_STEPS):
        speed = data.rotor_speed[rows + step]
        simulations[0].step(speed)
        simulations[1].step(speed + pulse if step < PULSE_STEPS else speed)
    before, after = (simulation.state for simulation in simulations)
    return np.hstack([(after - before)[:, VELOCITY], (after - before)[:, RATE]])


def quaternion_angle(one: Floats, other: Floats) -> Floats:
    """(m,) angle between two attitudes (m, 4), rad."""
    return np.asarray(2 * np.arccos(np.clip(np.abs(np.sum(one * other, axis=1)), 0, 1)))


def rms(values: Floats) -> float:
    """Root of the mean over the rows of the squared length of (m, k) vectors."""
    return float(np.sqrt(np.mean(np.sum(values**2, axis=1))))
