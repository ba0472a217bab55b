"""The command behind a result, which every artefact records."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path


def command_line() -> str:
    """The command that started this process: of `alula`, or of a Python script that uses it."""
    program = Path(sys.argv[0])
    if program.name == "alula" or program.parts[-2:] == ("alula", "__main__.py"):
        return shlex.join(["alula", *sys.argv[1:]])
    return shlex.join(["python", *sys.argv])
