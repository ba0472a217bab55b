"""Writes the small copies in this folder: the columns that diagnosis reads, without digits beyond the sensors' own.

PYTHONPATH=. python tests/data/nanobench/thin.py FOLDER_OF_FULL_FLIGHTS
"""

from __future__ import annotations

import csv
import gzip
import io
import sys
from pathlib import Path

from flights.mapping import FOLDER, read_mapping

FLIGHTS = ("B3_figure8_fast_rep1", "B9_trefoil_fast_rep1")
DIGITS = {"t": 6, "q": 7, "pwr": 3, "p": 6, "v": 5, "imu": 5, "motor": 0}  # by the beginning of a column's name


def main() -> None:
    """Writes the copies beside this file."""
    columns = read_mapping(FOLDER / "nanobench.toml").columns
    for name in FLIGHTS:
        with gzip.open(Path(sys.argv[1]) / f"{name}.csv.gz", "rt", newline="") as full:
            rows = [[_rounded(row[column], column) for column in columns] for row in csv.DictReader(full)]
        text = io.StringIO()
        csv.writer(text, lineterminator="\n").writerows([columns, *rows])
        Path(__file__).with_name(f"{name}.csv.gz").write_bytes(gzip.compress(text.getvalue().encode(), 9, mtime=0))


def _rounded(value: str, column: str) -> str:
    digits = next(count for beginning, count in DIGITS.items() if column.startswith(beginning))
    return f"{float(value):.{digits}f}" if value else ""


if __name__ == "__main__":
    main()
