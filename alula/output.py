"""Answers that programs read."""

from __future__ import annotations

import sys
from pathlib import Path

import msgspec

from dynamics.errors import RequestError


def write_json(value: msgspec.Struct, path: Path) -> None:
    """Write a struct as indented JSON; `-` is standard output. Raises RequestError when it cannot be written."""
    text = msgspec.json.format(msgspec.json.encode(value)) + b"\n"
    if path == Path("-"):
        sys.stdout.buffer.write(text)
        sys.stdout.buffer.flush()
        return
    try:
        path.write_bytes(text)
    except OSError as error:
        raise RequestError(f"cannot write {path}: {error}. Give a folder that can be written.") from error
