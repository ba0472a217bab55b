"""Write the locks: every version of constraints.txt with the hashes that the package index lists for its files.

    python requirements/make_locks.py [--uv PATH] [--index URL]

uv resolves for all platforms and Python versions at once (`pip install uv` into any environment; nothing else here
needs it). Names and versions come from pyproject.toml and constraints.txt: change these, then run this. torch and the
CUDA libraries that its build on PyPI brings have files of their own, since only some builds need the latter.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import tempfile
from pathlib import Path

HERE = Path(__file__).parent
ROOT = HERE.parent
EXTRAS = {"workbench": ("workbench",), "development": ("workbench", "test", "lint")}
TORCH = "torch"
CUDA = re.compile(r"(nvidia-|cuda-|triton==)")
# Builds for the processor alone, which PyPI does not hold: their files are those of the PyTorch project's own index.
CPU_BUILDS = {
    "torch-2.13.0+cpu-cp311-cp311-manylinux_2_28_x86_64.whl": (
        "6746dbcbeb526eb61330b76b41ff1b4eb848951103a892eeb080dfa2b264667b"
    ),
}
HEAD = "# Written by requirements/make_locks.py from pyproject.toml and constraints.txt; see docs/supply_chain.md.\n"


def main() -> None:
    """Resolve, split and write."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--uv", default="uv")
    parser.add_argument("--index", default="https://pypi.org/simple")
    arguments = parser.parse_args()
    for name, extras in EXTRAS.items():
        entries = resolved(arguments.uv, arguments.index, extras)
        plain = [entry for entry in entries if not CUDA.match(entry) and not entry.startswith(f"{TORCH}==")]
        (HERE / f"{name}.lock").write_text(HEAD + "".join(plain))
        torch = next(entry for entry in entries if entry.startswith(f"{TORCH}=="))
        added = "".join(f" \\\n    --hash=sha256:{digest}" for digest in CPU_BUILDS.values())
        (HERE / "torch.lock").write_text(HEAD + torch.rstrip("\n") + added + "\n")
        (HERE / "cuda.lock").write_text(HEAD + "".join(entry for entry in entries if CUDA.match(entry)))


def resolved(uv: str, index: str, extras: tuple[str, ...]) -> list[str]:
    """The requirements of some extras, each with its marker and hashes, in the order of their names."""
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder, "requirements.txt")
        options = ["--universal", "--generate-hashes", "--no-annotate", "--no-header", "--no-config", "--quiet"]
        chosen = [f"--extra={extra}" for extra in extras]
        command = [uv, "pip", "compile", "pyproject.toml", *chosen, *options, "--python-version=3.11.5"]
        command += ["--constraints=constraints.txt", f"--index-url={index}", f"--output-file={target}"]
        subprocess.run(command, cwd=ROOT, check=True)
        return re.findall(r"^[^\s#].*(?:\n[ \t].*)*\n", target.read_text(), re.MULTILINE)


if __name__ == "__main__":
    main()
