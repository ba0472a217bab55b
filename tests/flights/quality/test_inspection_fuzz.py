"""Whatever is wrong with a log, it is judged or refused by name; judging never breaks."""

from __future__ import annotations

from dataclasses import replace

import msgspec
import numpy as np
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from dynamics.errors import AlulaError
from flights.log import Log, Stream
from flights.quality.inspection import judge
from tests.support.simulated_flight import flown

DAMAGES = ("drop", "nan", "constant", "zero", "huge", "thin", "cut", "gap", "spike", "shift", "one_sample", "hold")


def damaged(stream: Stream, damage: str, seed: int) -> Stream | None:
    random = np.random.default_rng(seed)
    time, values = stream.time.copy(), stream.values.copy()
    place = int(random.integers(0, len(time) - 1))
    match damage:
        case "drop":
            return None
        case "nan":
            values[random.random(len(values)) < random.random()] = np.nan
        case "constant":
            values[:, int(random.integers(values.shape[1]))] = values[0, 0]
        case "zero":
            values[:] = 0.0
        case "huge":
            values *= 10.0 ** random.integers(2, 9)
        case "thin":
            every = int(random.integers(2, 200))
            time, values = time[::every], values[::every]
        case "cut":
            time, values = time[: place + 1], values[: place + 1]
        case "gap":
            rows = np.abs(np.arange(len(time)) - place) > 150
            time, values = (time[rows], values[rows]) if rows.any() else (time, values)
        case "spike":
            values[place] = 1e3
        case "shift":
            time = time + random.uniform(-30, 30)
        case "one_sample":
            time, values = time[:1], values[:1]
        case "hold":
            values = np.repeat(values[::50], 50, axis=0)[: len(values)]
    if stream.name.startswith("attitude"):  # as every reader does
        values = np.where(np.abs(np.linalg.norm(values, axis=1, keepdims=True) - 1) < 0.05, values, np.nan)
    return Stream(stream.name, time, values, stream.source)


@given(
    damages=st.dictionaries(
        st.sampled_from([stream.name for stream in flown().log.streams]), st.sampled_from(DAMAGES), max_size=6
    ),
    seed=st.integers(0, 1000),
    rows=st.sampled_from([5, 60, 700, 2000]),
)
@example(damages={"specific_force": "huge", "position": "shift"}, seed=0, rows=5)  # an impact without any height
@example(damages={"rate": "zero"}, seed=0, rows=700)  # a ratio to a size of zero
@example(damages={"position": "drop", "velocity": "gap"}, seed=419, rows=2000)  # a piece shorter than a block
@settings(max_examples=20, deadline=None, suppress_health_check=[HealthCheck.too_slow])
def test_any_damage_is_judged_or_refused_by_name(damages: dict[str, str], seed: int, rows: int) -> None:
    streams: list[Stream] = []
    for original in flown().log.streams:
        stream = Stream(original.name, original.time[:rows], original.values[:rows], original.source)
        result = damaged(stream, damages[stream.name], seed) if stream.name in damages else stream
        if result is not None:
            streams.append(result)
    log: Log = replace(flown().log, streams=tuple(streams))
    try:
        inspection = judge(log)
    except AlulaError:
        return
    assert inspection.sentence
    assert msgspec.json.decode(msgspec.json.encode(inspection))["verdict"] == inspection.verdict
