"""Lines that a page shows, compared with what was printed: numbers by tolerances of their kind, tables by cell.

| kind | written | tolerance |
| --- | --- | --- |
| count | a whole number, printed as one | none |
| share | in front of % | 2 points |
| time | in front of s, ms, min | 10 %, and at least a second where whole seconds are shown |
| size | in front of B, kB, MB, GB | 10 % |
| interval | behind a ± | 15 % |
| value | anything else: errors, parameters, RMSE | 3 % |

Half a unit of the last decimal place shown is always allowed. A comment in the page before a block of text,
`<!-- numbers within 40 %: reason -->`, replaces the tolerance of its numbers with a decimal point. A number within
a word (`drag2_4`) is a part of it.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

NUMBER = r"(?<![\w.])[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?(?!\w|\.\d)"
STATED = re.compile(r"<!-- numbers within (\d+) %: [^>]+-->")
COLUMN = re.compile("[│┃]")
UNIT = re.compile(r"\s*(%|ms\b|min\b|s\b|[kMG]?B\b)?")
POINTS, RELATIVE = 2.0, {"time": 0.1, "size": 0.1, "interval": 0.15, "value": 0.03}


@dataclass(frozen=True)
class Shown:
    """A line of a page. tolerance: relative, of its numbers with a decimal point; None for that of their kind."""

    text: str
    tolerance: float | None = None

    def __str__(self) -> str:
        return self.text


def missing(shown: Sequence[Shown], output: str) -> list[str]:
    """Lines that are not in an output."""
    return [line.text for line in shown if not is_printed(line, output)]


def is_printed(line: Shown, output: str) -> bool:
    """Whether a line, or a part of one, was printed with these numbers."""
    if COLUMN.search(line.text):
        return any(_is_row(line, row) for row in output.splitlines() if COLUMN.search(row))
    return _is_text(line, " ".join(output.split()))


def _is_row(line: Shown, row: str) -> bool:
    """Whether the first cells of a table's row are those of the line."""
    expected, cells = _cells(line.text), _cells(row)
    return len(expected) <= len(cells) and all(
        _is_text(Shown(text, line.tolerance), cell, is_all=True) for text, cell in zip(expected, cells, strict=False)
    )


def _cells(row: str) -> list[str]:
    """The cells of a row, without those that a border opens."""
    return [" ".join(cell.split()) for cell in COLUMN.split(row.strip().strip("│┃"))]


def _is_text(line: Shown, printed: str, *, is_all: bool = False) -> bool:
    text = " ".join(line.text.split())
    numbers = list(re.finditer(NUMBER, text))
    pattern, end = "", 0
    for number in numbers:
        pattern += re.escape(text[end : number.start()]) + f"({NUMBER})"
        end = number.end()
    pattern += re.escape(text[end:])
    places = re.finditer(f"^{pattern}$" if is_all else pattern, printed)
    return any(
        all(
            _is_near(number.group(), number_printed, text, number, line.tolerance)
            for number, number_printed in zip(numbers, place.groups(), strict=True)
        )
        for place in places
    )


def _is_near(shown: str, printed: str, text: str, place: re.Match[str], stated: float | None) -> bool:
    expected, actual = float(shown), float(printed)
    decimals = len(shown.partition("e")[0].partition(".")[2])
    rounding = 0.5 * 10.0**-decimals if decimals and "e" not in shown else 0.0
    kind = _kind(text, place)
    if kind == "count" and not re.fullmatch(r"[-+]?\d+", printed):
        kind = "value"  # which happened to be whole
    if kind == "count":
        return expected == actual
    if kind == "share":
        return abs(expected - actual) <= POINTS + rounding
    if stated is not None:
        return abs(expected - actual) <= stated * abs(expected) + rounding
    allowed = RELATIVE[kind] * abs(expected) + rounding
    return abs(expected - actual) <= (max(allowed, 1.0) if kind == "time" and not decimals else allowed)


def _kind(text: str, place: re.Match[str]) -> str:
    unit = UNIT.match(text, place.end())
    written = unit.group(1) if unit is not None else None
    if written == "%":
        return "share"
    if written in ("s", "ms", "min"):
        return "time"
    if written is not None:
        return "size"
    if text[: place.start()].rstrip().endswith("±"):
        return "interval"
    return "value" if "." in place.group() or "e" in place.group() else "count"


def blocks_of(page: str) -> Iterator[tuple[str, str, float | None]]:
    """Language and text of each fenced block, and the tolerance that a comment right before it states."""
    for block in re.finditer(r"^```(\w*)\n(.*?)^```", page, re.MULTILINE | re.DOTALL):
        before = page[: block.start()].rstrip().rpartition("\n")[2]
        stated = STATED.fullmatch(before)
        yield block.group(1), block.group(2), None if stated is None else int(stated.group(1)) / 100
