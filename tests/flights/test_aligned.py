"""Reading a log aligned: late streams are put right before they are joined; slower clocks fold nothing back."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from flights import Flight, read_aligned
from flights.log import Log, Provenance, Stream
from tests.support.simulated_flight import flown, table, values


def test_a_late_attitude_is_put_right_in_the_table(tmp_path: Path) -> None:
    log = flown().log
    late = replace(
        log,
        streams=tuple(
            Stream(s.name, s.time + 0.04, s.values, s.source) if s.name == "attitude" else s for s in log.streams
        ),
    )
    as_logged = table(late)
    path = as_logged.to_csv(tmp_path / "late.csv")
    aligned = read_aligned(path)
    delay_of_attitude = next(delay for delay in aligned.delays if delay.stream == "attitude")
    assert delay_of_attitude.seconds == pytest.approx(0.04, abs=0.002)
    true = table(flown().truth)

    def error(flight: Flight) -> float:
        rows = np.searchsorted(flight.time, true.time[200:-200] - 1e-3)
        return float(np.nanmedian(np.linalg.norm(flight["attitude"][rows] - true["attitude"][200:-200], axis=1)))

    assert error(aligned.flight) < 0.2 * error(as_logged)
    assert sum(segment.duration for segment in aligned.segments()) > 15.0


def test_a_slower_clock_folds_no_noise_back() -> None:
    random = np.random.default_rng(5)
    time = np.arange(20_000) / 1000.0
    slow = np.sin(2 * np.pi * 1.0 * time)[:, None] * np.ones(3)
    noisy = Stream("rate", time, slow + random.standard_normal((len(time), 3)), "gyro")
    flight = Flight.from_log(Log((noisy,), Provenance("planted", "", "", "")), rate=50.0)
    error = flight["rate"] - np.sin(2 * np.pi * 1.0 * flight.time)[:, None]
    assert np.nanstd(error) < 0.3  # 1 before, sqrt(2 * 0.4 * 50 / 1000) = 0.2 when nothing is folded back


def test_a_clock_as_fast_as_the_streams_changes_no_value() -> None:
    flight = table(flown().log)
    assert np.array_equal(flight["rate"], values(flown().log, "rate")[: len(flight)])
