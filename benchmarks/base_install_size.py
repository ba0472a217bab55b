"""Size of the flight computer's install on disk, which packages take it, and how long its commands take to start.

python -m benchmarks.base_install_size
"""

from __future__ import annotations

import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from importlib.metadata import distributions
from pathlib import Path

from benchmarks.provenance import write_result

ROOT = Path(__file__).resolve().parent.parent
OF_VENV = ("pip", "setuptools")  # which `python -m venv` brings
STARTS = 15
FLIGHT = ("alula.cli.fly", "runtime.daemon", "runtime.flight_setup", "simulation.flight_check")
COMMANDS = {
    "`alula --help`": ("-I", "-m", "alula", "--help"),
    "imports of `alula fly`": ("-I", "-c", f"import {', '.join(FLIGHT)}"),
}


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        python = f"{folder}/bin/python"
        subprocess.run([sys.executable, "-m", "venv", folder], check=True)
        install = [python, "-m", "pip", "install", "--quiet", "--constraint", "constraints.txt", "."]
        subprocess.run(install, cwd=ROOT, check=True)
        site = next(Path(folder).glob("lib/python*/site-packages"))
        sizes = {distribution.metadata["Name"]: _size(distribution) for distribution in distributions(path=[str(site)])}
        total_size = sum(path.lstat().st_size for path in site.rglob("*") if path.is_file())
        byte_code = sum(path.lstat().st_size for path in site.rglob("*.pyc"))
        starts = {name: _seconds([python, *command], folder) for name, command in COMMANDS.items()}
    rows = ["| package | MB |", "| --- | --- |"]
    for name, size in sorted(sizes.items(), key=lambda item: -item[1])[:12]:
        rows.append(f"| {name} | {size / 1e6:.1f} |")
    brought = total_size - sum(sizes[name] for name in OF_VENV if name in sizes)
    rows.append(f"| all of site-packages, byte code included | {total_size / 1e6:.0f} |")
    rows.append(f"| of that byte code | {byte_code / 1e6:.0f} |")
    rows.append(f"| all without pip and setuptools, which the virtual environment brings | {brought / 1e6:.0f} |")
    rows += ["", f"| start, median of {STARTS} | s |", "| --- | --- |"]
    rows += [f"| {name} | {seconds:.2f} |" for name, seconds in starts.items()]
    write_result("base_install_size", "Size of the base install", "\n".join(rows))


def _seconds(command: Sequence[str], folder: str) -> float:
    """Median time of a command, s, after a first run that fills the caches."""
    seconds = []
    for _ in range(STARTS + 1):
        start = time.perf_counter()
        subprocess.run(command, cwd=folder, check=True, capture_output=True)
        seconds.append(time.perf_counter() - start)
    return statistics.median(seconds[1:])


def _size(distribution: object) -> int:
    files = getattr(distribution, "files", None) or []
    return sum(Path(file.locate()).lstat().st_size for file in files if Path(file.locate()).exists())


if __name__ == "__main__":
    main()
