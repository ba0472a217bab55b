"""A propeller that shakes the vehicle once a turn is named with its rotor; shaking that is no rotor's is not."""

from __future__ import annotations

import numpy as np
import pytest

from dynamics.arrays import Floats
from flights.log import Log, Provenance, Stream
from flights.quality.propeller_imbalance import Imbalance, imbalance_findings, imbalances

DURATION, ROTORS = 30.0, 4
FINE = 8000.0  # Hz of the angles below


def smooth_noise(random: np.random.Generator, time: Floats, bandwidth: float, columns: int) -> Floats:
    """(n, columns) sums of cosines below a bandwidth, Hz, with standard deviation 1."""
    frequency, phase = random.uniform(0.05, bandwidth, (40, columns)), random.uniform(0, 2 * np.pi, (40, columns))
    return np.stack(
        [np.cos(2 * np.pi * np.outer(time, frequency[:, c]) + phase[:, c]).sum(axis=1) for c in range(columns)], axis=1
    ) / np.sqrt(20)


def shaken_log(
    seed: int,
    unbalanced: dict[int, float],
    *,
    hertz: float = 140.0,
    rate: float = 500.0,
    speed_rate: float = 100.0,
    late: float = 0.002,
    resonance: float = 0.0,
    manoeuvring: float = 0.08,
) -> Log:
    """A flight of four rotors about a frequency of turning, Hz; unbalanced: m/s^2 by rotor, at the usual speed.

    late: of the speeds, s. resonance: amplitude of a frame that rings at 142 Hz whatever the rotors do, m/s^2.
    """
    random = np.random.default_rng(seed)
    fine = np.arange(0.0, DURATION, 1 / FINE)
    share = 1 + random.normal(0, 0.02, ROTORS) + manoeuvring * smooth_noise(random, fine, 2.0, ROTORS)
    angle = 2 * np.pi * np.cumsum(hertz * share, axis=0) / FINE + random.uniform(0, 6, ROTORS)
    shaking = np.zeros((len(fine), 2))
    for rotor, amplitude in unbalanced.items():
        sign = (1, -1, 1, -1)[rotor]
        turned = np.column_stack([np.cos(angle[:, rotor]), sign * np.sin(angle[:, rotor])])
        shaking += amplitude * (share[:, [rotor]] ** 2) * turned
    shaking[:, 0] += resonance * np.cos(2 * np.pi * 142.0 * fine)
    time = np.arange(0.05, DURATION - 0.05, 1 / rate)
    rows = np.round(time * FINE).astype(int)
    propwash = np.convolve(random.normal(0, 1, len(time)), np.ones(4) / 2, mode="same")[:, None]  # coloured
    motion = 2 * smooth_noise(random, time, 3.0, 2)
    force = np.column_stack([motion + shaking[rows] + 0.6 * propwash + random.normal(0, 0.4, (len(time), 2)),
                             9.81 + random.normal(0, 1, len(time))])  # fmt: skip
    when = np.arange(0.05, DURATION - 0.05, 1 / speed_rate)
    hertz_seen = (hertz * share)[np.round((when - late) * FINE).astype(int)]
    speed = 2 * np.pi * np.round(hertz_seen / 0.24) * 0.24  # 100 electrical turns a minute, seven pole pairs
    streams = (
        Stream("specific_force", time, force, "made"),
        Stream("rotor_speed", when, speed, "made"),
    )
    return Log(streams, Provenance("made", "", "made", "made"))


def of(log: Log) -> tuple[Imbalance, ...]:
    return imbalances(log, [(0.2, DURATION - 0.2)])


@pytest.mark.parametrize("seed", range(5))
def test_the_unbalanced_propeller_is_named_with_its_amplitude(seed: int) -> None:
    every = of(shaken_log(seed, {2: 1.5}))
    assert [one.rotor for one in every if one.certain] == [2]
    assert every[2].amplitude == pytest.approx(1.5, rel=0.15)
    assert every[2].frequency == pytest.approx(140, rel=0.07)


def test_two_are_told_apart() -> None:
    every = of(shaken_log(11, {0: 2.0, 3: 1.0}))
    assert [one.rotor for one in every if one.certain] == [0, 3]
    assert [every[r].amplitude for r in (0, 3)] == pytest.approx([2.0, 1.0], rel=0.2)


@pytest.mark.parametrize("seed", range(5))
def test_noise_and_a_frame_that_rings_are_no_propeller(seed: int) -> None:
    assert not any(one.certain for one in of(shaken_log(seed, {})))
    ringing = of(shaken_log(seed, {}, resonance=2.0))
    assert not any(one.certain for one in ringing)


def test_a_slow_log_folds_the_line_and_says_so() -> None:
    log = shaken_log(3, {1: 1.5}, rate=200.0)
    every = of(log)
    assert [(one.rotor, one.folded) for one in every if one.certain] == [(1, True)]
    (finding,) = imbalance_findings(log, [(0.2, DURATION - 0.2)])
    assert (finding.name, finding.severity) == ("propeller_imbalance", "warning")
    assert "rotor 1 shakes the vehicle once a turn" in finding.text
    assert "or more" in finding.text


def test_speeds_that_stand_still_name_nobody() -> None:
    assert not any(one.certain for one in of(shaken_log(4, {1: 1.5}, manoeuvring=0.0)))


def test_without_measured_speeds_nothing_is_said() -> None:
    log = shaken_log(5, {1: 1.5})
    assert of(Log(log.streams[:1], log.provenance)) == ()
