"""`import alula` stays light, and gives what it promises when asked."""

from __future__ import annotations

import subprocess
import sys

import pytest

import alula
import flights


def test_importing_alula_brings_nothing_of_the_desk() -> None:
    script = (
        "import sys, alula; alula.__version__; "
        "print([name for name in ('flights', 'pyarrow', 'pyulog', 'rosbags', 'scipy', 'torch') if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True, timeout=60)
    assert done.stdout.strip() == "[]"


def test_the_public_names_are_those_of_their_rooms() -> None:
    assert alula.Flight is flights.Flight
    assert alula.read_log is flights.read_log
    with pytest.raises(AttributeError, match="no attribute 'Fligth'"):
        alula.Fligth  # noqa: B018
