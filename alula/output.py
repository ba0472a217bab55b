"""Answers that programs read."""

from __future__ import annotations

import sys
from pathlib import Path

import msgspec

from dynamics.files import write_whole


def write_json(value: msgspec.Struct, path: Path) -> None:
    """Write a struct as indented JSON; `-` is standard output. Raises RequestError when it cannot be written."""
    text = msgspec.json.format(msgspec.json.encode(value)) + b"\n"
    if path == Path("-"):
        sys.stdout.buffer.write(text)
        sys.stdout.buffer.flush()
        return
    write_whole(path, lambda part: part.write_bytes(text), advice="Give a folder that can be written.")
