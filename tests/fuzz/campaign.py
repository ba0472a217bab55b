"""Fuzzing of a group of targets: starts workers, watches their time, counts executions and collects finds."""

from __future__ import annotations

import json
import os
import select
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Generator, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tests.fuzz.targets import targets_of

ROOT = Path(__file__).parents[2]
SECONDS = 20.0  # of the processor for one input, of which the slowest seed takes a twentieth
SILENCE = 240.0  # s by the clock, for a process that waits and computes nothing
GOOD = ("read", "refused")


@dataclass(frozen=True)
class Find:
    """An input that gave neither a result nor an error of ours.

    number: of the input, or its name in the corpus.
    kind: exception, crash, hang, memory, printed, no message; harness for a mistake of the fuzzer's own.
    text: the exception, or what was printed.
    trace: the places that it came through.
    """

    target: str
    number: str
    kind: str
    text: str
    trace: tuple[str, ...] = ()

    @property
    def place(self) -> str:
        """The kind, and the innermost place in this repository: finds of one place have one cause."""
        own = [line for line in self.trace if not line.startswith(("/", "<", "tests/"))]
        return f"{self.kind} {own[-1] if own else self.text[:80]}"

    def __str__(self) -> str:
        where = "".join(f"\n    {line}" for line in self.trace[-6:])
        return f"{self.target} {self.number}: {self.kind}: {self.text}{where}"


@dataclass
class Campaign:
    """The course of a campaign. executions: inputs that ended, by target. outcomes: by their name."""

    executions: Counter[str] = field(default_factory=Counter)
    outcomes: Counter[str] = field(default_factory=Counter)
    seeds_refused: list[str] = field(default_factory=list)
    finds: list[Find] = field(default_factory=list)

    def add(self, target: str, number: str, outcome: str, text: str = "", trace: tuple[str, ...] = ()) -> Find | None:
        """Take an input's end; returns the find that it is, or None."""
        self.executions[target] += 1
        self.outcomes[outcome] += 1
        if outcome == "refused" and number.startswith("seed"):
            self.seeds_refused.append(f"{target} {number}: {text}")
        if outcome in GOOD:
            return None
        self.finds.append(Find(target, number, outcome, text, trace))
        return self.finds[-1]


def round_of(group: str, number: int) -> dict[str, range]:
    """The inputs of a round, of as many as a target has a share of a minute; no two rounds have one in common."""
    return {
        target.name: range(number * target.executions, (number + 1) * target.executions)
        for target in targets_of(group).values()
    }


def fuzz(group: str, plan: Mapping[str, range], campaign: Campaign) -> Iterator[Find]:
    """Read the inputs of a plan, by target of a group; yields finds as they come."""
    plan = dict(plan)
    while plan:
        died = yield from _watched(group, plan, campaign)
        if died is None:
            return
        name, number = died
        names = list(plan)[list(plan).index(name) :]
        rest = {later: plan[later] for later in names[1:]}
        # a seed, or a file of the corpus, would kill the next process as well
        plan = {name: range(int(number) + 1, plan[name].stop), **rest} if number.isdecimal() else rest


def _watched(
    group: str, plan: Mapping[str, range], campaign: Campaign
) -> Generator[Find, None, tuple[str, str] | None]:
    """One worker. Returns target and number of the input that it did not survive, None when it reached the end."""
    words = json.dumps({name: [numbers.start, numbers.stop] for name, numbers in plan.items()})
    command = [sys.executable, "-m", "tests.fuzz.worker", group, words]
    names = list(plan)
    errors = subprocess.DEVNULL
    process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=errors, env=_environment())
    current: tuple[str, str] | None = (names[0], "start")
    kind = "crash"
    try:
        for message in _messages(process):
            if message is None:
                kind = "hang"
                break
            if "begin" in message:
                current = message["target"], message["begin"]
                continue
            fields = message["outcome"], message.get("text", ""), tuple(message.get("trace", ()))
            if find := campaign.add(*(message["target"], message["end"]), *fields):
                yield find
            current = None
        if kind == "crash":
            process.wait()
    finally:
        process.kill()
        process.wait()
        assert process.stdout is not None
        process.stdout.close()
    if process.returncode == 0:
        return None
    died = current or (names[-1], "end")
    find = campaign.add(*died, kind, f"the process ended with {process.returncode}")
    assert find is not None
    yield find
    return died


def _messages(process: subprocess.Popen[bytes]) -> Iterator[dict[str, Any] | None]:
    """The worker's messages; None when it takes too long for one."""
    assert process.stdout is not None
    pending, heard, used = b"", time.monotonic(), _processor_time(process.pid)
    while True:
        ready, _, _ = select.select([process.stdout], [], [], 0.5)
        if ready:
            data = os.read(process.stdout.fileno(), 1 << 16)
            if not data:
                return
            *lines, pending = (pending + data).split(b"\n")
            yield from map(json.loads, lines)
            heard, used = time.monotonic(), _processor_time(process.pid)
        elif _processor_time(process.pid) - used > SECONDS or time.monotonic() - heard > SILENCE:
            yield None
            return


def _processor_time(pid: int) -> float:
    """Seconds of the processor that a process has had; a machine's load does not make an input slow."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _environment() -> dict[str, str]:
    threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    return {**os.environ, **threads, "PYTHONHASHSEED": "0"}
