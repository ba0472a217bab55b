"""Measurements of many cases: a finished one is a line of a file, so that a run that was stopped resumes."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, TypeVar

from benchmarks.provenance import write_result
from flights.parallel import parallel_map

Case = TypeVar("Case")
Result = Mapping[str, Any]


def options_of(description: str | None, name: str, *, jobs: int = 1, **counts: int) -> argparse.ArgumentParser:
    """`--jobs`, `--kept` and `--table` of results/NAME.md, and an integer option for each of the counts."""
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    for count, default in counts.items():
        parser.add_argument(f"--{count.replace('_', '-')}", type=int, default=default)
    parser.add_argument("--jobs", type=int, default=jobs)
    parser.add_argument("--kept", type=Path, default=Path(f"build/{name}.jsonl"), help="where finished cases are kept")
    parser.add_argument("--table", action="store_true", help=f"write benchmarks/results/{name}.md")
    return parser


def finished(file: Path, key: str = "key") -> dict[Any, Result]:
    """Results that a file has, by their key."""
    lines = file.read_text().splitlines() if file.exists() else []
    return {result[key]: result for result in map(json.loads, lines)}


def keep(file: Path, result: Result, line: str) -> None:
    """Append a result to the file, and print a line about it."""
    file.parent.mkdir(parents=True, exist_ok=True)
    with file.open("a") as lines:
        print(json.dumps(result), file=lines)
    print(line, flush=True)


def measured(
    measure: Callable[[Case], Result],
    cases: Iterable[Case],
    options: argparse.Namespace,
    line: Callable[[Result], str],
    *,
    key_of: Callable[[Case], Any],
    key: str = "key",
) -> list[Result]:
    """Results of all cases in their order; measured are those that `options.kept` lacks.

    line: about a result, to be printed.
    key_of: of a case; its result has the same under `key`.
    """
    cases = list(cases)
    done = finished(options.kept, key)
    todo = [case for case in cases if key_of(case) not in done]
    for _, result in parallel_map(measure, todo, jobs=options.jobs):
        done[result[key]] = result
        keep(options.kept, result, line(result))
    return [done[key_of(case)] for case in cases if key_of(case) in done]


def publish(name: str, title: str, body: str, options: argparse.Namespace) -> None:
    """Write results/NAME.md with `--table`, or else print the body."""
    if options.table:
        write_result(name, title, body)
    else:
        print(body)
