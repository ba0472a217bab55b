"""A judge's question that is answered without any flight, in a module that other processes import quickly."""

from __future__ import annotations

import os
import signal
from pathlib import Path

from benchmarks.verdict.cases import Case
from benchmarks.verdict.record import Record
from benchmarks.verdict.scoring import Answer, Expected

JUDGED = "JUDGED_CASES"  # file to which a process adds the case that it was asked
KILLED_SEED = 3
NAMED = {
    "name": "linear_drag", "rotor": None, "confidence": 1.0, "ambiguous_with": [],
    "parameters": {"coefficient": {"value": 0.021, "std": 0.001, "unit": "N s/m"}},
}  # fmt: skip


def named_drag(case: Case) -> Record:
    """A record that names a drag; the process that is asked the case of `KILLED_SEED` is killed."""
    with Path(os.environ[JUDGED]).open("a") as file:
        print(case.key, file=file)
    if case.seed == KILLED_SEED:
        os.kill(os.getpid(), signal.SIGKILL)
    expected = Expected({"linear_drag": {"coefficient": 0.02}}, ("linear_drag",))
    return Record(case.key, case.set_name, case.seed, expected, Answer({"verdict": "effect", "effects": [NAMED]}), 2.0)
