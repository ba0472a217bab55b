"""Replays of recordings, each in a process of its own; the answers are kept while the server runs."""

from __future__ import annotations

import subprocess
import sys
import threading
from pathlib import Path

from dynamics.decoding import decode_json
from runtime.replay import ReplayReport

RUNNING = "It is flown again; this takes about a tenth of the flight's time."


class Replays:
    """Replays of recordings and their outcomes, in sentences."""

    def __init__(self) -> None:
        self._lines: dict[Path, list[str]] = {}
        self._processes: dict[Path, subprocess.Popen[str]] = {}

    def start(self, path: Path) -> None:
        """Fly a recording again, unless that is being done."""
        if path in self._processes:
            return
        command = [sys.executable, "-P", "-m", "alula", "replay", str(path), "--json"]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        self._processes[path], self._lines[path] = process, [RUNNING]
        threading.Thread(target=self._collect, args=(path, process), daemon=True, name="studio replay").start()

    def lines(self, path: Path) -> list[str]:
        """The answer, or that it is awaited; empty for a recording that was not replayed."""
        return self._lines.get(path, [])

    def close(self) -> None:
        """End what runs."""
        for process in list(self._processes.values()):
            process.kill()

    def _collect(self, path: Path, process: subprocess.Popen[str]) -> None:
        answer, errors = process.communicate()
        if process.returncode == 0:
            lines = decode_json(answer, ReplayReport).lines
        else:
            lines = [errors.strip().removeprefix("alula: ") or f"The replay ended with {process.returncode}."]
        self._lines[path] = lines
        del self._processes[path]
