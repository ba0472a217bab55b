"""The harness sees what it is there to see: each kind of find, planted."""

from __future__ import annotations

import random
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.fuzz import targets
from tests.fuzz.campaign import Campaign, fuzz
from tests.fuzz.mutation import Parts, mutated
from tests.fuzz.worker import made

PLANTED = """
import ctypes
import numpy as np
from dynamics.errors import DataError
from tests.fuzz.target import Target


def _refuse(path):
    raise DataError("no flight in it. Give another one.")


def _printed(path):
    ctypes.CDLL(None).puts(b"bad header")
    ctypes.CDLL(None).fflush(None)


def _spin(path):
    while True:
        pass


def _silent(path):
    raise DataError("")


def _target(name, read):
    def only_mutated(path):
        return None if path.read_bytes() == b"seed" else read(path)

    return Target(name, lambda folder: [{"file": b"seed"}], only_mutated, executions=1)


TARGETS = tuple(_target(name, read) for name, read in {
    "fine": lambda path: path.stat().st_size,
    "refused": _refuse,
    "exception": lambda path: {}["absent"],
    "crash": lambda path: ctypes.string_at(0),
    "hang": _spin,
    "memory": lambda path: np.ones(1 << 28),
    "printed": _printed,
    "no message": _silent,
    "after": _refuse,
}.items())
"""


@pytest.fixture
def planted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """A group of targets with one fault each, in a module that workers find as well."""
    (tmp_path / "planted_targets.py").write_text(PLANTED)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.setattr("tests.fuzz.campaign.SECONDS", 2.0)
    yield "planted_targets"
    sys.modules.pop("planted_targets", None)


def test_every_kind_of_fault_is_a_find_and_nothing_else_is(planted: str) -> None:
    of_name = targets.targets_of(planted)
    seed: list[Parts] = [{"file": b"seed"}]
    changed = (n for n in range(100) if all(made(target, seed, n) != seed[0] for target in of_name.values()))
    number, campaign = next(changed), Campaign()
    finds = list(fuzz(planted, {name: range(number, number + 1) for name in of_name}, campaign))
    assert {find.target: find.kind for find in finds} == {
        name: name for name in ("exception", "crash", "hang", "memory", "printed", "no message")
    }
    assert {find.number for find in finds} == {str(number)}
    assert campaign.outcomes["refused"] == 2
    assert next(find for find in finds if find.target == "exception").text == "KeyError('absent')"


def test_the_input_of_a_number_is_always_the_same() -> None:
    parts = {"a": b"t,x\n0,1\n1,2\n", "b": bytes(range(256))}
    first, again, other = (mutated(parts, random.Random(f"x {n}"), others=[parts]) for n in (3, 3, 4))
    assert first == again
    assert first != other
