"""Measurements by theme and name, each of which writes its own page of benchmarks/results.

python -m benchmarks                         all themes, their measurements and pages
python -m benchmarks link flood --help       one measurement's options
python -m benchmarks link flood --quick      its smallest form, in seconds, printed and not written
python -m benchmarks link flood              the measurement as its page has it
python -m benchmarks link                    all of a theme, one after the other
python -m benchmarks all                     all themes
"""

from __future__ import annotations

import importlib
import subprocess
import sys
from collections.abc import Callable, Sequence

from benchmarks.catalogue import THEMES, Measurement
from benchmarks.measurement import Page, own_command
from benchmarks.provenance import commit, provenance, write_result

NOT_A_PAGE = ("--quick", "--no-page")
REQUEST = 2


def function_of(measurement: Measurement) -> Callable[[Sequence[str]], Page | None]:
    """The function that takes a measurement; only now its module is imported."""
    module, _, name = measurement.function.partition(":")
    function: Callable[[Sequence[str]], Page | None] = getattr(importlib.import_module(module), name)
    return function


def take(measurement: Measurement, words: Sequence[str]) -> None:
    """Take one measurement, and write or print its page."""
    commit()  # the one that is measured, not one that is made meanwhile
    options = [*measurement.quick, *words] if "--quick" in words else list(words)  # a later option wins
    page = function_of(measurement)(options)
    if page is None:
        return
    if page.trial or any(word in NOT_A_PAGE for word in words):
        print(f"# {page.title}\n\n{provenance()}\n\n{page.body.strip()}")
    else:
        write_result(page.name, page.title, page.body)


def take_all(themes: Sequence[str], words: Sequence[str]) -> int:
    """Take all measurements of themes, each in a process of its own. Returns the exit code."""
    failed = []
    for theme in themes:
        for name, measurement in THEMES[theme].items():
            if measurement.in_study:
                print(f"== {theme} {name}", flush=True)
                if subprocess.run(own_command(theme, name, *words), check=False).returncode:
                    failed.append(f"{theme} {name}")
    if failed:
        print(f"failed: {', '.join(failed)}", file=sys.stderr)
    return int(bool(failed))


def catalogue() -> str:
    """All themes, their measurements and pages, and what these need."""
    rows = [
        (theme, name, ", ".join(m.pages) + (f" (needs {m.needs})" if m.needs else ""))
        for theme, names in THEMES.items()
        for name, m in names.items()
    ]
    widths = [max(len(row[column]) for row in rows) for column in (0, 1)]
    return "\n".join(f"{theme:{widths[0]}}  {name:{widths[1]}}  {pages}" for theme, name, pages in rows)


def main(words: Sequence[str]) -> int:
    """Act on a command line. Returns the exit code."""
    if not words or words[0] in ("-h", "--help"):
        print(f"{__doc__}\n{catalogue()}")
        return 0
    theme, *rest = words
    if theme == "all":
        return take_all(list(THEMES), rest)
    if theme not in THEMES:
        print(f"benchmarks: {theme!r} is no theme. Wanted: all, {', '.join(THEMES)}.", file=sys.stderr)
        return REQUEST
    names = list(THEMES[theme])
    if len(names) == 1 and rest[:1] != names:
        rest = [*names, *rest]
    if rest[:1] in (["-h"], ["--help"]):
        print("\n".join(line for line in catalogue().splitlines() if line.split()[0] == theme))
        return 0
    if not rest or rest[0].startswith("-"):
        return take_all([theme], rest)
    name, *options = rest
    if name not in names:
        print(f"benchmarks: {theme} measures {', '.join(names)}; {name!r} was given.", file=sys.stderr)
        return REQUEST
    take(THEMES[theme][name], options)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
