"""Write docs/supply_chain.md: what an install brings, by which lock, under which licence.

python docs/make_licences.py            # write the page
python docs/make_licences.py --check    # end with 1 where it differs from what it would be
"""

from __future__ import annotations

import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGE = Path(__file__).with_name("supply_chain.md")
HEAD = """# Supply chain

Made from the locks in `requirements/` and the installed packages' metadata by `python docs/make_licences.py`.

`make demo` and `make test` install file by file: pip takes nothing whose SHA-256 is not in a lock, and resolves
nothing (`--require-hashes --no-deps`). The locks hold the hashes of all files that PyPI has of a version, so they serve
Python 3.11 to 3.13 on every platform that Alula runs on; versions are those of `constraints.txt`.

| lock | what it is for |
| --- | --- |
| `build.lock` | the wheel in a container: setuptools, and the messages of pymavlink |
| `flight_computer.lock` | a flight computer's container, and any install without the workbench |
| `workbench.lock` | `make demo`, and all other targets that fly, train and diagnose |
| `development.lock` | `make test`, `make lint`, `make fuzz`: the same and what tests and checks need |

Outside of the locks are:

- **torch**, and the CUDA libraries that its build on PyPI requires: pinned by version alone. There are builds with and
  without CUDA on several indexes, and any will do. In pip's hash mode a file that an index lists with its hash comes
  before one that a folder holds: tried with the hashes of both in one lock, it took PyPI's build, with gigabytes of
  CUDA, on a machine that has the small one at hand.
- **`make docs`**, whose packages are pinned by version in `constraints.txt`, and an install by pip into an
  environment of your own, which pip resolves by the ranges in `pyproject.toml`.
- **The wheel's own build** by `pip wheel`, which fetches setuptools and pymavlink by the ranges in `pyproject.toml`; in
  `make demo` and `make test` both come out of the lock (`--no-build-isolation`).
- **What is no Python package**: Python, pip, the C compiler, make, Chromium for the tests of pages.

`make wheel` writes a software bill of materials in CycloneDX 1.6 beside the wheels, `dist/alula-VERSION.cdx.json`: what
the flight computer's install requires, what the workbench adds, and what is compiled into the wheel. `make licences`
writes locks and this page anew after a change of `pyproject.toml` or `constraints.txt`; it needs
[uv](https://docs.astral.sh/uv/).

## Licences

As SPDX expressions, from each package's metadata or licence file. Alula itself is under Apache-2.0. CasADi (LGPL) is
loaded as a library of its own, and no wheel and no bundle has a part of it; pymavlink's generated messages, which a
wheel carries, are under MIT. cvxopt (GPL) comes with rotorpy, a second
simulator that the tests alone compare with; no wheel and no bundle has it.

| package | version | licence | for |
| --- | --- | --- | --- |
"""


def page() -> str:
    """The page's text."""
    sys.path.insert(0, str(ROOT / "requirements"))
    from licences import locked, torch

    workbench = {item.name for item in locked("workbench")}
    rows = [(item, "workbench" if item.name in workbench else "tests and checks") for item in locked("development")]
    rows.append((torch(), "workbench"))
    lines = [
        f"| {item.name} | {item.version} | {item.licence} | {use} |\n"
        for item, use in sorted(rows, key=lambda row: row[0].name)
    ]
    return HEAD + "".join(lines)


def main() -> None:
    """Write the page, or compare it."""
    text = page()
    if "--check" not in sys.argv:
        PAGE.write_text(text, encoding="utf-8")
    elif not PAGE.is_file() or PAGE.read_text(encoding="utf-8") != text:
        sys.exit("docs/supply_chain.md is out of date: run python docs/make_licences.py")


if __name__ == "__main__":
    main()
