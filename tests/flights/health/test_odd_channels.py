"""Channels that are missing, empty, single, or without a number: an answer, never an error."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from flights.health.answer import Health
from flights.health.px4 import read
from flights.health.reading import judge_health
from flights.health.record import AutopilotSeries, build_record
from flights.log import Log, Stream
from flights.reading import read_log
from flights.source import opened

LOG = Path("tests/data/default_rate_logs/uavcan.ulg.gz")


@pytest.fixture(scope="module")
def log() -> Log:
    return read_log(LOG)


@pytest.fixture(scope="module")
def autopilot(log: Log) -> AutopilotSeries:
    with opened(LOG) as source:
        return read(source.file, log.start)


def answered(log: Log, autopilot: AutopilotSeries) -> Health:
    health = judge_health(build_record(log, autopilot))
    assert len(health.sentences) == 2
    assert all(np.isfinite((s.evidence.start, s.evidence.end, s.evidence.value)).all() for s in health.statements)
    return health


@pytest.mark.parametrize("change", ["missing", "nan", "one sample", "zero"])
def test_one_quantity_after_the_other(log: Log, autopilot: AutopilotSeries, change: str) -> None:
    def changed(stream: Stream) -> Stream:
        if change == "one sample":
            return replace(stream, time=stream.time[:1], values=stream.values[:1])
        return replace(stream, values=np.full_like(stream.values, np.nan if change == "nan" else 0.0))

    for name in log.names:
        others = tuple(stream for stream in log.streams if stream.name != name)
        own = () if change == "missing" else tuple(changed(stream) for stream in log.alternatives(name))
        assert answered(replace(log, streams=(*others, *own)), autopilot).in_air >= 0.0


def test_no_channel_at_all(log: Log) -> None:
    assert answered(replace(log, streams=()), AutopilotSeries()).sentences[0].endswith("did not fly in this log.")


def test_without_what_the_autopilot_says_of_itself(log: Log) -> None:
    assert answered(log, AutopilotSeries()).in_air > 0.0
