"""Timestamps of signing never repeat, whatever ends a process and whatever its clock says."""

from __future__ import annotations

import multiprocessing
import os
import signal
import stat
import time
from multiprocessing.connection import Connection
from pathlib import Path

import msgspec
import pytest

from dynamics.errors import RequestError
from dynamics.signing_key import TICKS, SigningKey, signing_ticks
from runtime.link import signing_clock
from runtime.link.signing_clock import RESERVE, SigningClock, SigningState, state_path
from tests.support.deadline import wait_until


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "alula" / "signing-x.json"


def test_it_counts_with_the_clock_and_an_orderly_end_gives_the_reserve_back(path: Path) -> None:
    for _ in range(20):
        clock = SigningClock(path)
        assert -TICKS < clock.now - signing_ticks(time.time()) < TICKS
        clock.close()
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert stat.S_IMODE(path.parent.stat().st_mode) == 0o700


def _use(path: Path, report: Connection) -> None:
    clock = SigningClock(path)
    while True:
        report.send(clock.now)
        time.sleep(0.001)


def test_a_process_that_is_killed_leaves_no_timestamp_that_is_used_again(path: Path) -> None:
    context, latest = multiprocessing.get_context("fork"), 0
    for _ in range(3):
        receiver, sender = context.Pipe(duplex=False)
        process = context.Process(target=_use, args=(path, sender))
        process.start()
        first = last = receiver.recv()
        assert first > latest
        for _ in range(20):
            last = receiver.recv()
        os.kill(process.pid or 0, signal.SIGKILL)
        process.join()
        latest = last
    clock = SigningClock(path)
    clock.close()
    assert clock.now > latest


def test_a_clock_that_is_set_back_repeats_nothing(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = SigningClock(path)
    first.close()
    monkeypatch.setattr(signing_clock.time, "time", lambda: 1_500_000_000.0)
    second = SigningClock(path)
    second.close()
    assert second.now > first.now - TICKS
    assert second.lead > 1e8


def test_processes_at_the_same_time_use_different_timestamps(path: Path) -> None:
    first, second = SigningClock(path), SigningClock(path)
    used = second.now
    assert used >= first.now + RESERVE - TICKS
    second.close()
    first.close()
    third = SigningClock(path)
    third.close()
    assert third.now > max(first.now, used)


def test_it_moves_up_to_a_vehicle_that_is_ahead_once_that_is_saved(path: Path) -> None:
    clock = SigningClock(path)
    for lead in (TICKS, 3600 * TICKS, 100 * 365 * 86400 * TICKS):  # the last one is beyond what 48 bits hold
        target = clock.now + lead
        clock.move_up_to(target)
        if target < 1 << 48:
            wait_until(lambda target=target: clock.now >= target)
            assert msgspec.json.decode(path.read_bytes(), type=SigningState).timestamp > clock.now
    assert clock.now < target
    clock.close()


def test_a_disk_that_fails_is_known_and_stops_nothing(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    clock = SigningClock(path)

    def fail(*_: object) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(signing_clock, "replace_own", fail)
        clock.move_up_to(clock.now + 100 * RESERVE)
        wait_until(lambda: "No space" in clock.failure)
        before = clock.now
        wait_until(lambda: clock.now > before)
    clock.close()
    assert not clock.failure


@pytest.mark.parametrize(
    "content", [b"", b"{}", b"no", b'{"timestamp": "x"}', b'{"timestamp": 1, "heard": [[1, 1, 2]]}']
)
def test_a_damaged_state_is_refused_and_not_begun_anew(content: bytes, path: Path) -> None:
    path.parent.mkdir()
    path.write_bytes(content)
    with pytest.raises(RequestError, match=r"signing-x\.json.*damaged"):
        SigningClock(path)


def test_a_state_that_others_may_write_is_refused(path: Path) -> None:
    SigningClock(path).close()
    path.chmod(0o666)
    with pytest.raises(RequestError, match="others may write"):
        SigningClock(path)


def test_the_state_has_a_file_for_each_key_that_does_not_show_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    paths = {state_path(SigningKey(bytes([number]) * 32)) for number in (1, 2)}
    assert len(paths) == 2
    assert all(path.parent == tmp_path / "alula" and "0101" not in path.name for path in paths)
