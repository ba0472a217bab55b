"""Write the locks: every version of constraints.txt with the hashes that the package index lists for its files.

    python requirements/make_locks.py [--uv PATH] [--index URL]

uv resolves for all platforms and Python versions at once (`pip install uv` into any environment; nothing else here
needs it). Names and versions come from pyproject.toml and constraints.txt: change these, then run this. torch and the
CUDA libraries that one of its builds brings are left out.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import tempfile
import tomllib
from pathlib import Path

HERE = Path(__file__).parent
ROOT = HERE.parent
EXTRAS = {"flight_computer": (), "workbench": ("workbench",), "development": ("workbench", "test", "lint")}
BUILD = "build"  # what builds a wheel, without what that requires: setup.py imports none of it
OUTSIDE = re.compile(r"(torch==|triton==|nvidia-|cuda-)")  # see docs/supply_chain.md
HEAD = "# Written by requirements/make_locks.py from pyproject.toml and constraints.txt; see docs/supply_chain.md.\n"


def main() -> None:
    """Resolve, split and write."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--uv", default="uv")
    parser.add_argument("--index", help="address of a package index, by default uv's own")
    arguments = parser.parse_args()
    for name, extras in EXTRAS.items():
        entries = resolved(arguments.uv, arguments.index, extras)
        text = "".join(entry for entry in entries if not OUTSIDE.match(entry))
        (HERE / f"{name}.lock").write_text(HEAD + text, encoding="utf-8")
    (HERE / f"{BUILD}.lock").write_text(HEAD + "".join(entries_of_build()), encoding="utf-8")


def resolved(uv: str, index: str | None, extras: tuple[str, ...]) -> list[str]:
    """The requirements of some extras, each with its marker and hashes, in the order of their names."""
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder, "requirements.txt")
        options = ["--universal", "--generate-hashes", "--no-annotate", "--no-header", "--no-config", "--quiet"]
        chosen = [f"--extra={extra}" for extra in extras]
        command = [uv, "pip", "compile", "pyproject.toml", *chosen, *options, "--python-version=3.11.5"]
        command += [
            "--constraints=constraints.txt",
            f"--output-file={target}",
            *([f"--index-url={index}"] if index else []),
        ]
        subprocess.run(command, cwd=ROOT, check=True)
        return re.findall(r"^[^\s#].*(?:\n[ \t].*)*\n", target.read_text(), re.MULTILINE)


def entries_of_build() -> list[str]:
    """The entries of the workbench's lock that pyproject.toml requires for building."""
    required = tomllib.loads((ROOT / "pyproject.toml").read_text())["build-system"]["requires"]
    names = [re.split(r"[^\w.-]", text, maxsplit=1)[0] for text in required]
    entries = re.findall(r"^[^\s#].*(?:\n[ \t].*)*\n", (HERE / "workbench.lock").read_text(), re.MULTILINE)
    return [entry for entry in entries if entry.partition("==")[0] in names]


if __name__ == "__main__":
    main()
