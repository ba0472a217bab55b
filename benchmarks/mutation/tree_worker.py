"""Runs tests on mutants of one tree, each in a fork of a process that has imported the libraries already.

Nothing of this project is imported here: it comes from the tree, which is this process' working directory. Run by
`tests_kill.py`, which writes a request a line, and reads an answer a line:

    python benchmarks/mutation/tree_worker.py   {"module": "dynamics.frames", "tests": ["tests/..."], "limit": 60, ..}

limit: s of the processor. Answers with pytest's exit code, or minus the signal that ended it, and the seconds taken.
"""

from __future__ import annotations

import json
import os
import resource
import signal
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import casadi  # noqa: F401 - imported once, for all forks
import msgspec  # noqa: F401
import numpy  # noqa: F401
import pytest
import scipy  # noqa: F401

WRONG_TREE = 99
WALL = 600  # s, for tests that wait for what a mutant never does
OPTIONS = ("-x", "-q", "-m", "not slow and not realtime", "-p", "no:cacheprovider", "--hypothesis-seed=0")


def run_tests(module: str, tests: Sequence[str], limit: int, *, writes_bytecode: bool) -> int:
    """Pytest's exit code, in a process of its own session."""
    os.setsid()
    sys.dont_write_bytecode = not writes_bytecode  # of mutants none stays
    resource.setrlimit(resource.RLIMIT_CPU, (limit, limit + 1))
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    code = int(pytest.main([*OPTIONS, *tests]))
    file = getattr(sys.modules.get(module), "__file__", None)
    return code if file is None or Path(file).is_relative_to(Path.cwd()) else WRONG_TREE


def answer(module: str, tests: Sequence[str], limit: int, *, writes_bytecode: bool) -> tuple[int, float]:
    """(exit code or minus a signal, s of the processor)."""
    child = os.fork()
    if child == 0:
        try:
            os._exit(run_tests(module, tests, limit, writes_bytecode=writes_bytecode))
        except BaseException:  # a mutant may raise anything where pytest does not catch it
            os._exit(1)
    deadline = time.monotonic() + WALL
    while (ended := os.wait4(child, os.WNOHANG))[0] == 0:
        if time.monotonic() > deadline:
            os.killpg(child, signal.SIGKILL)
        time.sleep(0.05)
    usage = ended[2]
    return os.waitstatus_to_exitcode(ended[1]), usage.ru_utime + usage.ru_stime


if __name__ == "__main__":
    sys.path[:0] = [str(Path.cwd())]
    for line in sys.stdin:
        print(json.dumps(answer(**json.loads(line))), flush=True)
