"""The timestamp of MAVLink 2 signing, which never repeats: not after a restart, a crash, or a clock that was set back.

It counts 10 us since 2015 (mavlink.io, Message Signing, "Timestamp Handling"). It begins at the later of the system's
clock and what is saved, follows the monotonic clock, and is moved up to that of a vehicle that is ahead. What may be
used is saved before it is used, some seconds ahead; an orderly end saves what was used. One file a key.
"""

from __future__ import annotations

import threading
import time
from pathlib import Path
from typing import Annotated

import msgspec

from dynamics.decoding import decode_json
from dynamics.errors import RequestError
from dynamics.field_errors import described
from dynamics.own_folder import locked, make_own_folder, read_own, replace_own, state_folder
from dynamics.signing_key import TICKS, SigningKey, signing_ticks

END = 1 << 48  # a timestamp has 48 bits: the year 2104
RESERVE = 10 * TICKS  # saved ahead
_MARGIN = TICKS // 100  # beyond the last one that was used, saved at the end
_RENEWAL = 4.0  # s between two writings
_MAX_BYTES = 1 << 20

Stream = tuple[int, int, int]  # system, component, link id


class SigningState(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Signing state that outlives a process.

    timestamp: the first that is certainly unused.
    heard: the latest timestamp of each stream: system, component, link id, timestamp.
    """

    timestamp: Annotated[int, msgspec.Meta(ge=0)]
    heard: tuple[tuple[int, int, int, int], ...] = ()


def state_path(key: SigningKey) -> Path:
    """The file of a key's state. Raises RequestError for a user without a home."""
    try:
        return state_folder() / f"signing-{key.fingerprint}.json"
    except RuntimeError:
        raise RequestError("this user has no home folder. Set XDG_STATE_HOME to a folder of yours.") from None


class SigningClock:
    """The timestamps of one process under one key; `close` saves where they ended.

    heard: the latest timestamp that each stream was accepted with, which the next process begins with.
    failure: why the state could not be saved last, empty if it was.
    """

    def __init__(self, path: Path) -> None:
        """Reserve the first timestamps. Raises RequestError where the state cannot be read or kept."""
        self._path, self._lock = path, threading.Lock()
        self.failure, self._shared, self._pending = "", False, 0
        self.heard: dict[Stream, int] = {}
        try:
            make_own_folder(path.parent, _unusable)
            with locked(path.parent):
                state = self._read()
                self._base, self._origin = max(signing_ticks(time.time()), state.timestamp), time.monotonic()
                if self._base >= END - RESERVE:
                    raise _unusable(path, "its timestamps are used up. Make a new key: alula link --new-signing-key")
                self.heard.update(_by_stream(state))
                self._reserved = self._base + RESERVE
                self._write(self._reserved, state)
        except OSError as error:
            raise RequestError(
                f"cannot keep the timestamps of signing in {path}: {error.strerror or error}. "
                "Set XDG_STATE_HOME to a folder of yours."
            ) from None
        self._wake, self._ended = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._run, name="signing clock", daemon=True)
        self._thread.start()

    @property
    def now(self) -> int:
        """The present timestamp."""
        return self._base + int((time.monotonic() - self._origin) * TICKS)

    @property
    def origin(self) -> tuple[int, float]:
        """A timestamp and when it was, s, monotonic: what `now` counts on from."""
        return self._base, self._origin

    @property
    def lead(self) -> float:
        """Seconds that it is ahead of the system's clock."""
        return (self.now - signing_ticks(time.time())) / TICKS

    def move_up_to(self, timestamp: int) -> None:
        """Continue from a vehicle's timestamp that is ahead, once that is saved. Never waits for the disk."""
        if timestamp <= self.now or timestamp >= END - RESERVE:
            return
        with self._lock:
            if timestamp + RESERVE // 2 <= self._reserved:
                self._base += max(0, timestamp - self.now)
                return
            self._pending = max(self._pending, timestamp)
        self._wake.set()

    def close(self) -> None:
        """Save the timestamp that comes next, and what was heard."""
        self._ended.set()
        self._wake.set()
        self._thread.join()
        self._save(reserve=0)

    def _run(self) -> None:
        while not self._ended.is_set():
            self._wake.wait(_RENEWAL)
            self._wake.clear()
            if not self._ended.is_set():
                self._save(reserve=RESERVE)

    def _save(self, reserve: int) -> None:
        """Save what may be used from now on; then a vehicle's timestamp that waits for it is taken."""
        with self._lock:
            pending, self._pending = self._pending, 0
        unused = max(self.now, pending) + max(reserve, _MARGIN)
        try:
            with locked(self._path.parent):
                saved = self._read()
                self._shared |= saved.timestamp != self._written  # by another process with this key, at any time
                self._write(max(saved.timestamp, unused) if reserve or self._shared else unused, saved)
        except (OSError, RequestError) as error:
            self.failure = str(error)
            return
        self.failure = ""
        with self._lock:
            self._reserved = unused
            self._base += max(0, pending - self.now)

    def _read(self) -> SigningState:
        content = read_own(self._path, _MAX_BYTES, _unusable)
        if content is None:
            return SigningState(0)
        try:
            return decode_json(content, SigningState)
        except msgspec.MsgspecError as error:
            raise _unusable(
                self._path, f"it is damaged: {described(error)}. Make a new key and remove this file"
            ) from None

    def _write(self, timestamp: int, saved: SigningState) -> None:
        heard = _by_stream(saved)
        for stream, stamp in tuple(self.heard.items()):
            heard[stream] = max(stamp, heard.get(stream, 0))
        rows = tuple((*stream, stamp) for stream, stamp in heard.items())
        replace_own(self._path, msgspec.json.encode(SigningState(timestamp, rows)))
        self._written = timestamp


def _by_stream(state: SigningState) -> dict[Stream, int]:
    return {(system, component, link_id): stamp for system, component, link_id, stamp in state.heard}


def _unusable(path: Path, reason: str) -> RequestError:
    return RequestError(f"{path} says which timestamps of signing are used, and cannot be read: {reason}.")
