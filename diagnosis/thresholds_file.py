"""Thresholds from a TOML file: a table for each subject, with the fields that differ from their defaults."""

from __future__ import annotations

import tomllib
from pathlib import Path

import msgspec

from diagnosis.thresholds import Thresholds
from dynamics.decoding import parse_toml
from dynamics.errors import RequestError
from dynamics.field_errors import described


def read_thresholds(path: str | Path) -> Thresholds:
    """The thresholds of a file; what is not in it keeps its default.

    Raises RequestError for a file that cannot be read, an unknown name, or a value out of range, with the range.
    """
    try:
        table = parse_toml(Path(path).read_text(encoding="utf-8"))
        return msgspec.convert(table, Thresholds)
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError, msgspec.ValidationError) as error:
        raise RequestError(
            f"cannot use the thresholds of {path}: {described(error)}. `diagnosis/thresholds/` lists all of "
            "them with their units and bounds."
        ) from error
