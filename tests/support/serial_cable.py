"""Two serial devices, pseudo-terminals, joined by a cable that loses bytes and can be unplugged and plugged in."""

from __future__ import annotations

import contextlib
import os
import random
import select
import threading
import tty
from pathlib import Path
from types import TracebackType
from typing import Self

POLL = 0.02  # s between looks at the ends


class SerialCable:
    """A cable between a vehicle's device and one near us; `with SerialCable(folder) as cable:` plugs it in.

    far: path of the vehicle's device, which is always there.
    near: path of our device, which is there while the cable is plugged in.
    loss: probability that a byte is lost, in both directions.
    lost: bytes so far.
    """

    def __init__(self, folder: Path, *, seed: int = 0) -> None:
        self.near = str(folder / "ttyNEAR")
        self.loss = 0.0
        self.lost = 0
        self._random = random.Random(seed)
        self._far, far_device = os.openpty()
        tty.setraw(far_device)
        self._devices = [far_device]
        self.far = os.ttyname(far_device)
        self._near: int | None = None
        self._lock = threading.Lock()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="cable", daemon=True)

    def __enter__(self) -> Self:
        self.plug()
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stop.set()
        self._thread.join()
        self.unplug()
        for descriptor in (self._far, *self._devices):
            os.close(descriptor)

    def plug(self) -> None:
        """Make our device appear."""
        near, device = os.openpty()
        tty.setraw(device)
        os.symlink(os.ttyname(device), self.near)
        os.close(device)
        with self._lock:
            self._near = near

    def unplug(self) -> None:
        """Make our device disappear: whoever has it open reads its end."""
        with self._lock, contextlib.suppress(FileNotFoundError):
            os.unlink(self.near)
            if self._near is not None:
                os.close(self._near)
            self._near = None

    def _run(self) -> None:
        while not self._stop.is_set():
            with self._lock:
                ends = [self._far] if self._near is None else [self._far, self._near]
                readable, _, _ = select.select(ends, [], [], 0.0)
                for end in readable:
                    self._carry(end, self._near if end == self._far else self._far)
            if not readable:
                self._stop.wait(POLL / 10)

    def _carry(self, source: int, sink: int | None) -> None:
        try:
            data = os.read(source, 4096)
        except OSError:  # nobody has the other side open at the moment
            self._stop.wait(POLL)
            return
        arriving = data if not self.loss else bytes(byte for byte in data if self._random.random() >= self.loss)
        self.lost += len(data) - len(arriving)
        if sink is not None and select.select([], [sink], [], 0.0)[1]:
            with contextlib.suppress(OSError):
                os.write(sink, arriving)
