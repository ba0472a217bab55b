"""Provenance of every page of results: date, commit, machine, versions, command."""

from __future__ import annotations

import datetime
import os
import platform
import subprocess
import sys
from functools import cache
from importlib import metadata
from pathlib import Path

RESULTS = Path(__file__).parent / "results"
LOAD = os.getloadavg()[0]  # before the measurement itself


@cache
def commit() -> str:
    """The commit when this was first asked for, and whether code that git tracks differs from it; pages of results do
    not count.
    """
    try:
        command = ["git", "rev-parse", "--short", "HEAD"]
        folder = Path(__file__).parent
        name = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=True).stdout.strip()
        command = [
            "git",
            "status",
            "--porcelain",
            "--untracked-files=no",
            "--",
            ":/",
            ":(exclude,top)benchmarks/results",
        ]
        changed = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return "commit unknown (no git)"
    return f"commit {name}{' and uncommitted changes' if changed else ''}"


def processor() -> str:
    """The processor's name."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        return next(line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        return platform.processor()


def provenance() -> str:
    """One paragraph for the head of a page."""
    versions = ", ".join(f"{package} {metadata.version(package)}" for package in ("numpy", "casadi", "pymavlink"))
    command = " ".join(["python", *sys.orig_argv[1:]])
    return (
        f"{datetime.date.today().isoformat()}, {commit()}, {processor()}, {os.cpu_count()} cores, load {LOAD:.1f} "
        f"before, {platform.system()} {platform.release()}, Python {platform.python_version()}, {versions}. "
        f"Command: `{command}`"
    )


def write_result(name: str, title: str, body: str) -> Path:
    """Write results/NAME.md, headed by its provenance, and print it. Returns its path."""
    RESULTS.mkdir(exist_ok=True)
    path = RESULTS / f"{name}.md"
    text = f"# {title}\n\n{provenance()}\n\n{body.strip()}\n"
    path.with_suffix(".part").write_text(text)
    path.with_suffix(".part").replace(path)
    print(text)
    return path
