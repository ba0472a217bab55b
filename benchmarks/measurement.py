"""Scaffolding that all measurements share: options, pages, results that are kept, flights one by one, own processes."""

from __future__ import annotations

import argparse
import inspect
import json
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from flights.parallel import parallel_map

ROOT = Path(__file__).resolve().parents[1]
Case = TypeVar("Case")
Answer = TypeVar("Answer")
Result = Mapping[str, Any]


@dataclass(frozen=True)
class Page:
    """A page of results. A trial is printed and not written: its figures are of something else than the page's."""

    name: str
    title: str
    body: str
    trial: bool = False


def options_of(
    description: str | None, *, jobs: int | None = None, resumes: str | None = None, **counts: float
) -> argparse.ArgumentParser:
    """Options of a measurement: `--quick` and `--no-page`, which `benchmarks.__main__` acts on, and those named here.

    jobs: default of `--jobs`, which is left out without one.
    resumes: name of the file of finished cases, for measurements that resume.
    counts: an option with a number for each; its default says whether it is an integer.
    """
    text = inspect.cleandoc(description or "")
    parser = argparse.ArgumentParser(description=text, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name, default in counts.items():
        parser.add_argument(f"--{name.replace('_', '-')}", type=type(default), default=default, help=f"{default:g}")
    if jobs is not None:
        parser.add_argument("--jobs", type=int, default=jobs, help=f"processes, {jobs}")
    if resumes is not None:
        file = Path(f"build/{resumes}.jsonl")
        parser.add_argument("--kept", type=Path, default=file, help="where finished cases are kept, to be resumed")
        parser.add_argument("--cases", type=int, help="so many of the cases alone")
    parser.add_argument("--quick", action="store_true", help="the smallest form, in seconds, printed and not written")
    parser.add_argument("--no-page", action="store_true", help="print the page, write none")
    return parser


def add_names(parser: argparse.ArgumentParser, option: str, names: Iterable[str]) -> None:
    """An option for some of the names, by default all of them."""
    names = list(names)
    parser.add_argument(option, nargs="+", choices=names, default=names, metavar="NAME", help=", ".join(names))


def paragraph_of(description: str | None, number: int = 1) -> str:
    """One paragraph of a docstring, the second by default, as a page repeats it."""
    return inspect.cleandoc(description or "").split("\n\n")[number]


def own_command(theme: str, name: str, *options: str) -> list[str]:
    """The command line of a measurement in a process of its own."""
    return [sys.executable, "-m", "benchmarks", theme, name, *options]


def kept_results(file: Path) -> list[Any]:
    """Results that a file has, one a line."""
    return [json.loads(line) for line in file.read_text().splitlines()] if file.exists() else []


def keep(file: Path, *results: Any, line: str = "") -> None:
    """Append results to the file, and print a line about them where there is one."""
    file.parent.mkdir(parents=True, exist_ok=True)
    with file.open("a") as lines:
        lines.writelines(json.dumps(result) + "\n" for result in results)
    if line:
        print(line, flush=True)


def finished(file: Path, key: str = "key") -> dict[Any, Result]:
    """Results that a file has, by their key."""
    return {result[key]: result for result in kept_results(file)}


def measured(
    measure: Callable[[Case], Result],
    cases: Iterable[Case],
    options: argparse.Namespace,
    line: Callable[[Result], str],
    *,
    key_of: Callable[[Case], Any],
    key: str = "key",
) -> list[Result]:
    """Results of all cases in their order; measured are those that `options.kept` lacks, of the first `options.cases`.

    line: about a result, to be printed.
    key_of: of a case; its result has the same under `key`.
    """
    cases = list(cases)[: options.cases]
    done = finished(options.kept, key)
    todo = [case for case in cases if key_of(case) not in done]
    for _, result in parallel_map(measure, todo, jobs=options.jobs):
        done[result[key]] = result
        keep(options.kept, result, line=line(result))
    return [done[key_of(case)] for case in cases if key_of(case) in done]


def flown(fly: Callable[[Case], Answer], cases: Sequence[Case], *, jobs: int) -> list[Answer]:
    """Answers as they are finished, each printed then."""
    answers = []
    for _, answer in parallel_map(fly, cases, jobs=jobs):
        print(answer, flush=True)
        answers.append(answer)
    return answers
