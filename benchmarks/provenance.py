"""Provenance of every table of this folder: machine, date, command, versions."""

from __future__ import annotations

import datetime
import os
import platform
import sys
from importlib import metadata
from pathlib import Path

RESULTS = Path(__file__).parent / "results"
LOAD = os.getloadavg()[0]  # before the measurement itself


def provenance() -> str:
    """One paragraph for the head of a table."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        name = next(line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        name = platform.processor()
    versions = ", ".join(f"{package} {metadata.version(package)}" for package in ("numpy", "casadi", "pymavlink"))
    command = " ".join(["python", *sys.orig_argv[1:]])
    return (
        f"{datetime.date.today().isoformat()}, {name}, {os.cpu_count()} cores, load {LOAD:.1f} before, "
        f"{platform.system()} {platform.release()}, Python {platform.python_version()}, {versions}. "
        f"Command: `{command}`"
    )


def write_result(name: str, title: str, body: str) -> Path:
    """Write results/NAME.md and print it. Returns its path."""
    RESULTS.mkdir(exist_ok=True)
    path = RESULTS / f"{name}.md"
    text = f"# {title}\n\n{body.strip()}\n\n{provenance()}\n"
    path.with_suffix(".part").write_text(text)
    path.with_suffix(".part").replace(path)
    print(text)
    return path
