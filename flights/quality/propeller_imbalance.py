"""Unbalanced propellers: each shakes the vehicle once a turn, in the plane of the rotors, in phase with its rotor.

A propeller of mass m_u whose centre of mass is e off the axis pulls with m_u e Omega^2 as it turns (ISO 21940-11 calls
m_u e the residual unbalance). In short windows the accelerometer's x and y are fitted with cosine and sine of the
angles of all rotors, which are the integrals of their measured speeds (order tracking: Fyfe and Munck, Mechanical
Systems and Signal Processing 11, 1997). The phase is free in each window, so that errors of the speeds add up in none.
What the same fit gives at neighbouring frequencies is noise. A line above half of the accelerometer's rate is folded
with the angle's cosine, and found as well; the sensor's own filter has made it smaller.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dynamics.arrays import Floats
from flights.log import Log, Stream
from flights.quality.findings import Finding

WINDOW = 0.4  # s
MIN_WINDOWS, MAX_WINDOWS = 20, 300
MOTION = 10.0  # Hz up to which cosines of a window take up the vehicle's motion
MIN_FREQUENCY = 20.0  # Hz as it appears in the log, below which motion hides a line
MIN_SPEED_RATE = 20.0  # Hz of the rotors' speeds: with fewer the angle inside a window is a guess
MIN_ROWS = 60  # of the accelerometer in a window
MIN_SPREAD = 2.0  # resolutions 1 / WINDOW over which a rotor's frequency moves: a line that stands is not the rotor's
NEIGHBOURS = (-6.5, -5.5, -4.5, -3.5, 3.5, 4.5, 5.5, 6.5)  # resolutions beside the line, where noise is measured
MIN_DEVIATIONS = 6.0  # of the noise's power
FOLDED = 0.4  # of the accelerometer's rate, above which the amplitude is a lower bound
NOTABLE, STRONG = 0.3, 1.0  # m/s^2; the second is a tenth of gravity


@dataclass(frozen=True)
class Imbalance:
    """Force of a rotor's propeller once a turn.

    amplitude: of the specific force in the rotors' plane, m/s^2, at the rotor's usual speed.
    frequency: of turning, Hz, the median.
    certain: whether the line stands out of noise, and its frequency moves with the rotor's.
    folded: whether it lies above what the log's rate resolves, so that the amplitude is a lower bound.
    """

    rotor: int
    amplitude: float
    frequency: float
    certain: bool
    folded: bool


def imbalances(log: Log, segments: Sequence[tuple[float, float]]) -> tuple[Imbalance, ...]:
    """The imbalance of every rotor; empty where speeds were not measured, or too little was logged.

    segments: of free flight, start and end, s.
    """
    force, speed = log.stream("specific_force"), log.stream("rotor_speed")
    if force is None or speed is None or speed.rate < MIN_SPEED_RATE or force.rate * WINDOW < MIN_ROWS:
        return ()
    starts = [start + k * WINDOW for start, end in segments for k in range(int((end - start) / WINDOW))]
    chosen = starts[:: 1 + len(starts) // MAX_WINDOWS]
    windows = [lines for lines in (_lines(force, speed, start) for start in chosen) if lines is not None]
    if len(windows) < MIN_WINDOWS:
        return ()
    return tuple(_imbalance(rotor, windows, force.rate) for rotor in range(len(windows[0].frequency)))


def imbalance_findings(log: Log, segments: Sequence[tuple[float, float]]) -> list[Finding]:
    """Propellers that shake the vehicle. segments: of free flight, start and end, s."""
    every = imbalances(log, segments)
    findings = []
    for one in every:
        if not one.certain or one.amplitude < NOTABLE:
            continue
        others = ", ".join(f"{o.amplitude:.1f}" for o in every if o.rotor != one.rotor)
        bound = " or more, for the log is too slow to show all of it" if one.folded else ""
        text = (
            f"rotor {one.rotor} shakes the vehicle once a turn, at {one.frequency:.0f} Hz, with {one.amplitude:.1f} "
            f"m/s^2{bound}; the others with {others}"
        )
        if one.amplitude >= STRONG:
            advised = f"balance or change the propeller of rotor {one.rotor}, and look for a bent shaft"
            findings.append(Finding("warning", "propeller_imbalance", text, advised))
        else:
            findings.append(Finding("note", "propeller_imbalance", text))
    return findings


@dataclass(frozen=True, eq=False)
class _Lines:
    """Power of the rotors' lines in a window, (rotors,) each.

    frequency: of turning, Hz, means.
    power: squared amplitudes, (m/s^2)^2, at the rotors' speeds in the window.
    spread: of the power over that of white noise a row.
    neighbouring: (neighbours, rotors), the same power at neighbouring frequencies.
    """

    frequency: Floats
    power: Floats
    spread: Floats
    neighbouring: Floats


def _lines(force: Stream, speed: Stream, start: float) -> _Lines | None:
    """The lines in the window that starts at a time, s; None where it lacks rows."""
    rows = (force.time >= start) & (force.time < start + WINDOW)
    inside = (speed.time >= start) & (speed.time < start + WINDOW)
    about = (speed.time > start - WINDOW) & (speed.time < start + 2 * WINDOW)
    force_xy, turning = force.values[rows, :2], np.abs(speed.values[about])
    enough = rows.sum() >= MIN_ROWS and inside.sum() >= WINDOW * MIN_SPEED_RATE / 2
    if not enough or not np.isfinite(force_xy).all() or not np.isfinite(turning).all() or turning.min() <= 0:
        return None
    time = force.time[rows]
    now, angle = _turned(time, speed.time[about], turning)
    mean = now.mean(axis=0)
    strength, since = (now / mean) ** 2, time - start - WINDOW / 2  # the force goes with the square of the speed
    design = np.hstack([_motion(since), strength * np.cos(angle), strength * np.sin(angle)])
    inverse = np.linalg.pinv(design)
    fitted = inverse @ force_xy
    left = force_xy - design @ fitted
    power, spread = (_of_rotors(x, len(mean)) for x in (np.sum(fitted**2, axis=1) / 2, np.sum(inverse**2, axis=1)))
    neighbouring = np.empty((len(NEIGHBOURS), len(mean)))
    for place, offset in enumerate(NEIGHBOURS):
        shifted = angle + 2 * np.pi * offset / WINDOW * since[:, None]
        for rotor in range(len(mean)):
            columns = strength[:, [rotor]] * np.column_stack([np.cos(shifted[:, rotor]), np.sin(shifted[:, rotor])])
            columns = columns - design @ (inverse @ columns)
            inner = np.linalg.pinv(columns.T @ columns)
            noise = np.sum((inner @ (columns.T @ left)) ** 2) / 2
            neighbouring[place, rotor] = noise * spread[rotor] / np.trace(inner)
    return _Lines(mean / (2 * np.pi), power, spread, neighbouring)


def _motion(since: Floats) -> Floats:
    """(n, m) cosines that take up the vehicle's motion. since: the window's middle, s."""
    count = 1 + round(2 * WINDOW * MOTION)
    return np.asarray(np.cos(np.outer(since / WINDOW + 0.5, np.pi * np.arange(count))))


def _of_rotors(coefficients: Floats, rotors: int) -> Floats:
    """(rotors,) sums over cosine and sine, which stand behind the motion's."""
    return np.asarray(coefficients[-2 * rotors : -rotors] + coefficients[-rotors:])


def _turned(time: Floats, times: Floats, speed: Floats) -> tuple[Floats, Floats]:
    """Speed and angle, (n, rotors) each, at times, of a piecewise linear speed (m, rotors), rad/s."""
    step = np.diff(times)[:, None]
    angle = np.vstack([np.zeros(speed.shape[1]), np.cumsum(step * (speed[1:] + speed[:-1]) / 2, axis=0)])
    place = np.clip(np.searchsorted(times, time, side="right") - 1, 0, len(times) - 2)
    since, slope = (time - times[place])[:, None], (np.diff(speed, axis=0) / step)[place]
    return np.asarray(speed[place] + slope * since), np.asarray(
        angle[place] + since * (speed[place] + slope * since / 2)
    )


def _apparent(frequency: float, rate: float) -> float:
    """The frequency as which one appears in rows of a rate, Hz."""
    return abs(frequency - rate * round(frequency / rate))


def _imbalance(rotor: int, windows: Sequence[_Lines], rate: float) -> Imbalance:
    every = np.array([w.frequency[rotor] for w in windows])
    usual = float(np.median(every))
    folded = usual > FOLDED * rate
    chosen = [w for w in windows if _apparent(w.frequency[rotor], rate) > MIN_FREQUENCY]
    if len(chosen) < MIN_WINDOWS:
        return Imbalance(rotor, 0.0, usual, certain=False, folded=folded)
    frequency, power, spread = np.array([[w.frequency[rotor], w.power[rotor], w.spread[rotor]] for w in chosen]).T
    neighbouring = np.array([w.neighbouring[:, rotor] for w in chosen])
    weight, to_usual = 1 / spread, (usual / frequency) ** 4
    level, *levels = weight @ (to_usual[:, None] * np.column_stack([power, neighbouring])) / weight.sum()
    noise = float(np.median(levels))
    chance = noise * np.sqrt(0.5 / len(chosen))  # two coefficients of two axes in each window
    certain = level > noise + MIN_DEVIATIONS * max(chance, float(np.std(levels)))
    moves = float(np.subtract(*np.percentile(frequency, [95, 5]))) > MIN_SPREAD / WINDOW
    amplitude = float(np.sqrt(max(level - noise, 0.0)))
    return Imbalance(rotor, round(amplitude, 3), usual, certain=bool(certain and moves), folded=folded)
