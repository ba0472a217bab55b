"""Judges diagnosis: cases with a known truth, one line of scores a set. Writes benchmarks/results/verdict.md.

    python -m benchmarks.verdict [--sets captured px4_like] [--seeds 100000] [--processes 2] [--limit 1]
    python -m benchmarks.verdict --resume build/verdict/2026-11-27T18-30-00.123

Seeds below 100000 were used while rules were made. Every answer is kept as a JSON of its own in the run's folder, so
that a run that was stopped goes on with --resume; flights stay in build/flights for every later version of diagnosis.
Recordings of PX4 and RotorPy are not in this repository: name their folder with --recordings or ALULA_RECORDINGS. A run
of some sets, or with --limit, prints its page; only one of all sets is written to results.
"""

from __future__ import annotations

import argparse
import datetime
import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from benchmarks.provenance import write_result
from benchmarks.verdict.cases import Case, CaseSet, planned, read_sets
from benchmarks.verdict.posing import RECORDINGS, recordings
from benchmarks.verdict.record import Record
from benchmarks.verdict.run import Run, answer, finished, read_run, write_run
from benchmarks.verdict.scoring import outcome_of
from benchmarks.verdict.table import line, page
from dynamics.errors import AlulaError, RequestError

FIRST_SEED = 100_000
FOLDER = Path("build/verdict")
INTERRUPTED = 130
ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")  # a library, as processes are what is many


def parser() -> argparse.ArgumentParser:
    """The options."""
    made = argparse.ArgumentParser(
        "python -m benchmarks.verdict", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    made.add_argument("--sets", nargs="+", metavar="SET", help=f"of {', '.join(read_sets())}; all by default")
    made.add_argument("--seeds", type=int, metavar="FIRST", help=f"the first seed, {FIRST_SEED} by default")
    made.add_argument("--processes", type=int, default=2)
    made.add_argument("--limit", type=int, metavar="N", help="cases of each set at most")
    made.add_argument("--resume", type=Path, metavar="FOLDER", help="go on with the run in this folder")
    made.add_argument("--recordings", type=Path, metavar="FOLDER", help=f"of PX4 and RotorPy, in place of {RECORDINGS}")
    return made


def main(arguments: Sequence[str] | None = None) -> int:
    """Ask what has not been answered, and write the page. Returns the exit code."""
    options = parser().parse_args(arguments)
    for name in ONE_THREAD:
        os.environ.setdefault(name, "1")
    if options.recordings:
        os.environ[RECORDINGS] = str(options.recordings)
    try:
        return _judge(options)
    except AlulaError as error:
        print(error, file=sys.stderr)
        return error.exit_code


def _judge(options: argparse.Namespace) -> int:
    sets = read_sets()
    if options.resume:
        run, folder = _resumed(options), options.resume
    else:
        run = _begun(options, sets)
        folder = FOLDER / datetime.datetime.now().isoformat(timespec="milliseconds").replace(":", "-")
        write_run(run, folder)
    cases, notes = _with_recordings(planned(sets, run.sets, run.first, run.limit))
    print(*notes, f"{len(cases)} cases; answers are kept in {folder}", sep="\n", flush=True)
    try:
        records = _answered(cases, run, folder, options.processes)
    except KeyboardInterrupt:
        done = len(finished(cases, folder))
        print(f"Stopped; {done} of {len(cases)} are answered. Go on with --resume {folder}", file=sys.stderr)
        return INTERRUPTED
    _publish(records, sets, run, notes)
    return 0


def _begun(options: argparse.Namespace, sets: Mapping[str, CaseSet]) -> Run:
    first = FIRST_SEED if options.seeds is None else options.seeds
    if options.limit is not None and options.limit < 1:
        raise RequestError(f"--limit {options.limit}: wanted 1 or more.")
    planned(sets, options.sets or (), first, options.limit)  # names that there are
    return Run.begun(options.sets or list(sets), first, options.limit)


def _resumed(options: argparse.Namespace) -> Run:
    if options.sets is not None or options.seeds is not None or options.limit is not None:
        raise RequestError("--resume goes on with the sets, seeds and limit of its folder. Leave these options out.")
    return read_run(options.resume)


def _with_recordings(cases: Sequence[Case]) -> tuple[list[Case], list[str]]:
    """Cases whose logs are there, and a sentence about each set that is left out."""
    folder = recordings()
    absent = [
        case
        for case in cases
        if case.entry.source == "recorded"
        and (folder is None or not all((folder / f).exists() for f in case.entry.files))
    ]
    place = "no folder of recordings is named" if folder is None else f"their logs are not in {folder}"
    names = dict.fromkeys(case.set_name for case in absent)
    notes = [
        f"{sum(case.set_name == name for case in absent)} cases of {name} are left out: {place} (--recordings, "
        f"{RECORDINGS})."
        for name in names
    ]
    return [case for case in cases if case not in absent], notes


def _answered(cases: Sequence[Case], run: Run, folder: Path, processes: int) -> list[Record]:
    """Records of all cases, with a bar and a line for each."""
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, TimeRemainingColumn(), console=Console(stderr=True)) as bar:
        task = bar.add_task("flights, then answers", total=len(cases), completed=len(finished(cases, folder)))

        def note(record: Record) -> None:
            outcome = "lost" if record.lost else outcome_of(record.answer, record.expected)
            text = f"{record.took:6.1f} s  {outcome}  {line(record)}"
            bar.console.print(text, markup=False, highlight=False, soft_wrap=True)
            bar.advance(task)

        return answer(cases, run, folder, processes=processes, note=note)


def _publish(records: Sequence[Record], sets: Mapping[str, CaseSet], run: Run, notes: Sequence[str]) -> None:
    head = f"Commit {run.commit}, begun {run.date}, seeds from {run.first} on, {len(records)} cases."
    text = page(records, sets, "\n\n".join([head, *notes]))
    if run.limit is None and set(run.sets) == set(sets):
        write_result("verdict", "The judge of diagnosis", text)
    else:
        print(text)


if __name__ == "__main__":
    sys.exit(main())
