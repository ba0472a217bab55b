"""Right logs whose columns are declared wrong: is the cause told, is anything said of right ones."""

from __future__ import annotations

import argparse
import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks.measurement import ROOT, Page, options_of, paragraph_of
from dynamics.errors import AlulaError
from fixtures.wrong_columns import mutations
from flights.hypotheses import explain
from flights.log import Stream
from flights.reading import found_hypotheses, logs_below, read_log

DATA = ROOT / "tests" / "data"
NEEDED = {"attitude", "rate"}
MIN_FLIGHT = 8.0  # s
TURN, SHIFT = (20.0, 160.0), (0.15, 20.0)  # degrees, s of the draws


def wrong_columns(words: Sequence[str]) -> Page:
    """Logs of real vehicles and of simulators that are not ours, each changed in twenty ways that people meet.

    Turns are about a random axis by 20 to 160 degrees, clocks are off by 0.15 to 20 s. A log is told right where the
    cause is among what was found, silent where nothing at all is said, by hypotheses or by contradictions. Flights that
    move too little to tell are counted apart: those in which, as they are, less than half of the gyro's motion is the
    attitude's turning.

        python -m benchmarks readers wrong_columns [--recordings FOLDER] [--seed N]
    """
    options = _options().parse_args(words)
    folder = Path(os.environ.get("ALULA_RECORDINGS", DATA)) if options.recordings is None else options.recordings
    logs, refused = _right_logs(folder, options.logs)
    draws = np.random.default_rng(options.seed)
    counts: dict[str, np.ndarray] = {}
    wrong: list[str] = []
    brisk = 0
    for path, streams in logs:
        if not _moves(streams):
            continue
        brisk += 1
        drawn = mutations(draws.normal(size=3).tolist(), float(draws.uniform(*TURN)), float(draws.uniform(*SHIFT)))
        for name, (change, causes) in drawn.items():
            try:
                changed = list(change(dict(streams)).values())
            except KeyError:  # the log has no such quantity
                continue
            answers = [(one.name, one.text) for one in explain(changed)]
            names = {one for one, _ in answers}
            counts.setdefault(name, np.zeros(4, dtype=int))
            counts[name] += [1, bool(causes & names), bool(names) and not causes & names, not names]
            if not causes & names:
                wrong.append(f"{name} of {path.name}: {'; '.join(text for _, text in answers) or 'nothing'}")
    return Page(
        "wrong_columns", "Columns that are other than declared", _body(counts, wrong, len(logs), brisk, refused)
    )


def _options() -> argparse.ArgumentParser:
    options = options_of(wrong_columns.__doc__, logs=1000, seed=0)
    options.add_argument(
        "--recordings", type=Path, metavar="FOLDER", help="of right logs; ALULA_RECORDINGS, tests/data"
    )
    return options


def _right_logs(folder: Path, count: int) -> tuple[list[tuple[Path, dict[str, Stream]]], list[str]]:
    """Logs with attitude and rates below a folder, and those of which something is said although they are right."""
    logs, refused = [], []
    for path in logs_below(folder):
        if "field" in path.parts or len(logs) == count:
            continue
        try:
            refused += [f"{path.name}: {one.text}" for one in found_hypotheses(path)]  # also of one that is not read
            streams: dict[str, Stream] = {}
            for stream in read_log(path).streams:
                streams.setdefault(stream.name, stream)
        except AlulaError:  # no log, or one that is refused for another reason than its columns
            continue
        if streams.keys() >= NEEDED and np.ptp(streams["rate"].time) > MIN_FLIGHT:
            logs.append((path, streams))
    return logs, refused


def _moves(streams: dict[str, Stream]) -> bool:
    from flights.hypotheses.motion import Motion
    from flights.hypotheses.pose import CLOSES, declared

    reading = declared(Motion.of(streams))
    return reading is not None and reading.rate is not None and reading.rate.plain > CLOSES


def _body(counts: dict[str, np.ndarray], wrong: Sequence[str], logs: int, brisk: int, refused: Sequence[str]) -> str:
    total = sum(counts.values(), np.zeros(4, dtype=int))
    rows = [f"| {name} | {n} | {right} | {other} | {silent} |" for name, (n, right, other, silent) in counts.items()]
    rows.append("| **all** | " + " | ".join(map(str, total)) + " |")
    return "\n".join(
        [
            paragraph_of(wrong_columns.__doc__),
            "",
            f"{logs} right logs, of {len(refused)} of which something is said; {brisk} move enough to tell.",
            "",
            "| change | logs | right cause | another | nothing said |",
            "| --- | --- | --- | --- | --- |",
            *rows,
            "",
            *(f"- right, but: {line}" for line in refused),
            *(f"- {line}" for line in wrong),
        ]
    )
