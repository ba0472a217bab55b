"""Errors of a model in open loop: against what was flown, and its response to a pulse on the rotors."""

from __future__ import annotations

import msgspec
import numpy as np
from numpy.typing import NDArray

from diagnosis.models.open_loop import HorizonError, horizon_error, state_error
from diagnosis.thresholds import DEFAULT
from dynamics import quaternion
from dynamics.arrays import Floats
from dynamics.state import ATTITUDE, RATE, VELOCITY
from dynamics.units import RPM
from training.checkpoint import TrainedModel
from training.data.labelled_rows import LabelledRows
from training.open_loop import OpenLoopSimulation, warm_up

HORIZONS = DEFAULT.prediction.horizons  # s
START_INTERVAL = 0.25  # s between starts of open-loop predictions
PULSE = 200 * RPM
PULSE_STEPS, RESPONSE_STEPS = 1, 10  # of dt: 10 ms of pulse, read after 100 ms
MAX_PULSE_STARTS = 200  # spread over the flights
BODY_Z = np.array([0.0, 0.0, 1.0])


class Pulse(msgspec.Struct, frozen=True):
    """Error of the response to +200 rpm for 10 ms, over the response itself, 100 ms after it began.

    name: which rotors.
    rate: of body rates, None for all rotors, which hardly turn it.
    velocity: of velocity.
    thrust: of velocity along body z alone.
    """

    name: str
    rate: float | None
    velocity: float
    thrust: float


def open_loop_errors(model: TrainedModel, data: LabelledRows, states: Floats) -> tuple[HorizonError, ...]:
    """Errors of the model run from recorded states with recorded rotor speeds.

    states: (n, 13) that are compared with, NaN where unknown. Empty when no segment is long enough.
    """
    dt = model.config.dt
    steps = [round(horizon / dt) for horizon in HORIZONS]
    rows = start_rows(model, data, steps=steps[-1])[:: max(1, round(START_INTERVAL / dt))]
    rows = rows[np.isfinite(states[rows[:, None] + np.array([0, *steps])]).all(axis=(1, 2))]
    if not len(rows):
        return ()
    simulation, errors = _simulation(model, data, rows), []
    for step in range(1, steps[-1] + 1):
        simulation.step(data.rotor_speed[rows + step - 1])
        if step in steps:
            errors.append(horizon_error(step * dt, state_error(simulation.state, states[rows + step])))
    return tuple(errors)


def pulse_responses(model: TrainedModel, plant: TrainedModel, data: LabelledRows) -> tuple[Pulse, ...]:
    """Errors of the model's response to pulses on single rotors and on all of them; the plant's response is exact."""
    rows = start_rows(model, data, steps=RESPONSE_STEPS)
    rows = rows[:: max(1, len(rows) // MAX_PULSE_STARTS)]
    if not len(rows):
        return ()
    rotors = data.rotor_speed.shape[1]
    single = [_response_error(model, plant, data, rows, np.eye(rotors)[rotor]) for rotor in range(rotors)]
    collective = _response_error(model, plant, data, rows, np.ones(rotors))
    return (
        Pulse("one rotor", *np.sqrt(np.mean(np.square(single), axis=0)).tolist()),
        Pulse("all rotors", None, *collective[1:]),
    )


def start_rows(model: TrainedModel, data: LabelledRows, *, steps: int) -> NDArray[np.intp]:
    """Rows with enough columns before them, and `steps` rows after them, in one segment without a gap."""
    before = warm_up(model.config) - 1
    rows = np.arange(before, len(data.time) - steps)
    finite = np.asarray(np.isfinite(np.hstack([data.state, data.rotor_speed])).all(axis=1))
    breaks = np.concatenate([[0], np.cumsum(~finite | _first_rows(data))])
    # a segment's first row may be the oldest column, so it does not count as a break of the window that begins there
    unbroken = breaks[rows + steps + 1] - breaks[rows - before + 1] == 0
    starts: NDArray[np.intp] = rows[np.logical_and(unbroken, finite[rows - before])]
    return starts


def _first_rows(data: LabelledRows) -> NDArray[np.bool_]:
    """(n,) whether a row does not follow the one before it."""
    period = float(np.median(np.diff(data.time)))
    first = np.ones(len(data.time), dtype=bool)
    first[1:] = (np.diff(data.flight_of) != 0) | (np.abs(np.diff(data.time) - period) > 0.5 * period)
    return first


def _simulation(model: TrainedModel, data: LabelledRows, rows: NDArray[np.intp]) -> OpenLoopSimulation:
    window = rows[:, None] + np.arange(1 - warm_up(model.config), 1)
    return OpenLoopSimulation(model, data.state[window], data.rotor_speed[window[:, :-1]])


def _response_error(
    model: TrainedModel, plant: TrainedModel, data: LabelledRows, rows: NDArray[np.intp], rotors: Floats
) -> tuple[float, float, float]:
    """Relative errors of the response in body rates, velocity, velocity along body z. rotors: 1 for those pulsed."""
    predicted, true = (_response(one, data, rows, PULSE * rotors) for one in (model, plant))
    up = quaternion.rotate(data.state[rows, ATTITUDE], np.broadcast_to(BODY_Z, (len(rows), 3)))
    along, true_along = (np.sum(response[:, :3] * up, axis=1, keepdims=True) for response in (predicted, true))
    parts = ((predicted[:, 3:], true[:, 3:]), (predicted[:, :3], true[:, :3]), (along, true_along))
    rate, velocity, thrust = (rms(one - other) / max(rms(other), 1e-300) for one, other in parts)
    return rate, velocity, thrust


def _response(model: TrainedModel, data: LabelledRows, rows: NDArray[np.intp], pulse: Floats) -> Floats:
    """(m, 6) change of velocity and body rates by a pulse."""
    simulations = [_simulation(model, data, rows) for _ in range(2)]
    for step in range(RESPONSE_STEPS):
        speed = data.rotor_speed[rows + step]
        simulations[0].step(speed)
        simulations[1].step(speed + pulse if step < PULSE_STEPS else speed)
    without, with_pulse = (simulation.state for simulation in simulations)
    change = with_pulse - without
    return np.hstack([change[:, VELOCITY], change[:, RATE]])


def rms(values: Floats) -> float:
    """Root of the mean over the rows of the squared length of (m, k) vectors."""
    return float(np.sqrt(np.mean(np.sum(values**2, axis=1))))
