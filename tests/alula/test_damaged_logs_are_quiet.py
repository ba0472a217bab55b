"""A damaged log is read around its damage or refused, in few lines of ours: what a library prints reaches no terminal.

Standard output and error are captured as file descriptors, which libraries in C write to.
"""

from __future__ import annotations

import gzip
import random
import sys
import threading
import warnings
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from alula.cli.output import split_output
from flights.reading import read_log
from tests.support.command_line import Run, command_line
from tests.support.flight_files import dataflash_log, manoeuvre, tlog

ULOGS = Path(__file__).parents[1] / "data" / "px4_sih_flights"
TEXT_LOG = b"FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format,Columns\nATT, 1000, 0.0, 1.0\n" * 300


@cache
def _dataflash() -> bytes:
    return dataflash_log(manoeuvre())


@cache
def _tlog() -> bytes:
    return tlog(manoeuvre())


@cache
def _ulog() -> bytes:
    return gzip.decompress((ULOGS / "drag2_4_lemniscate.ulg.gz").read_bytes())


INTACT: dict[str, Callable[[], bytes]] = {".bin": _dataflash, ".log": lambda: TEXT_LOG, ".tlog": _tlog, ".ulg": _ulog}


def _damaged(content: bytes, seed: int, *, bytes_changed: int = 300) -> bytes:
    """Content with random bytes behind its first 64, and without its last hundred."""
    draw, changed = random.Random(seed), bytearray(content)
    for _ in range(bytes_changed):
        changed[draw.randrange(64, len(changed))] = draw.randrange(256)
    return bytes(changed[:-100])


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> Run:
    return command_line(monkeypatch, capfd)


@pytest.mark.parametrize("suffix", INTACT)
@pytest.mark.parametrize("seed", [11, 12])
def test_a_damaged_log_prints_lines_of_ours_alone(suffix: str, seed: int, run: Run, tmp_path: Path) -> None:
    log = tmp_path / f"flight{suffix}"
    log.write_bytes(_damaged(INTACT[suffix](), seed))
    code, shown, wrong = run("inspect", log)
    assert code in (0, 2, 3)
    assert [line for line in wrong.splitlines() if not line.startswith(f"alula: {log}")] == []
    assert len(wrong.splitlines()) == (code != 0)
    assert len([line for line in shown.splitlines() if line.startswith("damaged:")]) <= 4
    for text in ("bad header", "Skipped", "corruption", "Warning"):
        assert text not in shown


def test_a_dataflash_log_is_read_around_its_damage(tmp_path: Path) -> None:
    intact, damaged = tmp_path / "intact.bin", tmp_path / "damaged.bin"
    intact.write_bytes(_dataflash())
    damaged.write_bytes(_dataflash()[:3000] + _dataflash()[3010:])
    undamaged, rest = read_log(intact), read_log(damaged)
    assert len(rest.provenance.damage) == 1
    assert "damaged at 1 place" in rest.provenance.damage[0]
    for stream in undamaged.streams:
        remaining = rest.stream(stream.name)
        assert remaining is not None
        assert len(stream.time) - 2 <= len(remaining.time) <= len(stream.time)
        at = np.searchsorted(stream.time, remaining.time + rest.start - undamaged.start - 1e-7)
        np.testing.assert_allclose(remaining.values, stream.values[at])


def test_the_damage_of_a_tlog_is_shown(tmp_path: Path) -> None:
    log = tmp_path / "flight.tlog"
    log.write_bytes(_damaged(_tlog(), 5))
    assert any("fail their checksum" in damage for damage in read_log(log).provenance.damage)


def test_what_another_thread_prints_while_a_log_is_read_is_no_damage(tmp_path: Path) -> None:
    log = tmp_path / "flight.ulg"
    log.write_bytes(_ulog())
    reading = threading.Event()
    streams = []

    def print_all_the_while() -> None:
        while not reading.is_set():
            streams.append((sys.stdout, sys.stderr))

    thread = threading.Thread(target=print_all_the_while)
    thread.start()
    try:
        read = read_log(log)
    finally:
        reading.set()
        thread.join()
    assert set(streams) == {(sys.stdout, sys.stderr)}
    assert read.provenance.damage == ()


@pytest.mark.parametrize(("words", "count"), [([], 0), (["-v"], 1)])
def test_a_warning_of_a_library_is_shown_to_those_who_want_detail(words: list[str], count: int) -> None:
    with warnings.catch_warnings(record=True) as shown:
        warnings.simplefilter("always")
        _, output = split_output(words)
        output.start(words)
        warnings.warn("of a library", UserWarning, stacklevel=1)
        output.finish(0)
        assert len(shown) == count
        warnings.warn("afterwards", UserWarning, stacklevel=1)
        assert len(shown) == count + 1
