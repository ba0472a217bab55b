"""Modes and messages of an autopilot come with its log, on the log's own time."""

from __future__ import annotations

from pathlib import Path

import pytest

from flights import Flight, Log, read_chunks, read_log
from flights.events import cleaned, px4_mode
from studio.app.log_page import _messages, flight_figure
from studio.pages.flight_panels import drawn_columns, quantities_of
from studio.work.arrays import write_arrays
from studio.work.results import ColumnInfo, FlightInfo

LOG = Path(__file__).parents[1] / "data" / "px4_sih_offboard" / "offboard_hover_topics.ulg.gz"  # real PX4


@pytest.fixture(scope="module")
def log() -> Log:
    return read_log(LOG)


def test_modes_of_px4_are_read_in_their_order(log: Log) -> None:
    modes = [event for event in log.events if event.kind == "mode"]
    assert [event.text for event in modes][:2] == ["Hold", "Offboard"]
    assert 0.0 < modes[1].time < log.duration
    assert [event.time for event in log.events] == sorted(event.time for event in log.events)


def test_messages_have_their_level_and_no_colours_of_a_terminal(log: Log) -> None:
    texts = [event.text for event in log.events if event.kind == "message"]
    assert "INFO: [commander] Ready for takeoff!" in texts
    assert not [text for text in texts if not text.isprintable()]
    assert cleaned("\x1b[31mred\x1b[0m\x07" + "x" * 1000) == "red" + "x" * 297
    assert px4_mode(99) == "mode 99"


def test_a_part_of_a_log_has_the_events_of_its_time(log: Log) -> None:
    (offboard,) = [event for event in log.events if event.text == "Offboard"][:1]
    parts = list(read_chunks(LOG, 10.0))
    times = [
        (part.start - log.start + event.time) for part in parts for event in part.events if event.text == "Offboard"
    ]
    assert times[0] == pytest.approx(offboard.time, abs=1e-3)


def test_the_studio_marks_modes_and_lists_messages(log: Log, tmp_path: Path) -> None:
    import numpy as np

    flight = Flight.from_log(log)
    drawn, kinds = drawn_columns(flight), quantities_of(flight)
    write_arrays(tmp_path, {"time_0": flight.time, "table_0": np.array(list(drawn.values()), dtype=np.float32)})
    columns = tuple(ColumnInfo(name, kinds[name], "") for name in drawn)
    info = FlightInfo("log", "log.ulg", flight.duration, flight.rate, columns, events=log.events)
    figure = flight_figure(tmp_path, info, 0, "light")
    assert "Offboard" in [annotation.text for annotation in figure.layout.annotations]
    assert len(figure.layout.shapes) > 0
    assert "Ready for takeoff!" in str(_messages([info]))
    assert _messages([FlightInfo("log", "log.csv")]) is None
