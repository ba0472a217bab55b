"""Options and page of `benchmarks.witness`; all others take theirs from `benchmarks.measurement`."""

from __future__ import annotations

import argparse
from pathlib import Path

from benchmarks.measurement import measured
from benchmarks.provenance import write_result

__all__ = ["measured", "options_of", "publish"]


def options_of(description: str | None, name: str, *, jobs: int = 1, **counts: int) -> argparse.ArgumentParser:
    """`--jobs`, `--kept` and `--table` of results/NAME.md, and an integer option for each of the counts."""
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    for count, default in counts.items():
        parser.add_argument(f"--{count.replace('_', '-')}", type=int, default=default)
    parser.add_argument("--jobs", type=int, default=jobs)
    parser.add_argument("--kept", type=Path, default=Path(f"build/{name}.jsonl"), help="where finished cases are kept")
    parser.add_argument("--table", action="store_true", help=f"write benchmarks/results/{name}.md")
    return parser


def publish(name: str, title: str, body: str, options: argparse.Namespace) -> None:
    """Write results/NAME.md with `--table`, or else print the body."""
    if options.table:
        write_result(name, title, body)
    else:
        print(body)
