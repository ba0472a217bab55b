"""What the flight computer's install takes on disk, and which packages take it.

python -m benchmarks.base_install_size
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from importlib.metadata import distributions
from pathlib import Path

from benchmarks.provenance import write_result

ROOT = Path(__file__).resolve().parent.parent


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run([sys.executable, "-m", "venv", folder], check=True)
        install = [f"{folder}/bin/python", "-m", "pip", "install", "--quiet", "--constraint", "constraints.txt", "."]
        subprocess.run(install, cwd=ROOT, check=True)
        site = next(Path(folder).glob("lib/python*/site-packages"))
        sizes = {distribution.metadata["Name"]: _size(distribution) for distribution in distributions(path=[str(site)])}
        total_size = sum(path.lstat().st_size for path in site.rglob("*") if path.is_file())
    rows = ["| package | MB |", "| --- | --- |"]
    for name, size in sorted(sizes.items(), key=lambda item: -item[1])[:10]:
        rows.append(f"| {name} | {size / 1e6:.1f} |")
    rows.append(f"| all of site-packages, byte code included | {total_size / 1e6:.0f} |")
    write_result("base_install_size", "Size of the base install", "\n".join(rows))


def _size(distribution: object) -> int:
    files = getattr(distribution, "files", None) or []
    return sum(Path(file.locate()).lstat().st_size for file in files if Path(file.locate()).exists())


if __name__ == "__main__":
    main()
