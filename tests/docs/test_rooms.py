"""The import contracts that `make lint` enforces refuse what they are meant to: circles, and arrows up."""

import subprocess
import sys
import tomllib
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import Any

import grimp
import pytest

from tests.support.pages import ROOT

CONTRACTS = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"]
LINT = "import sys; sys.path.insert(0, ''); from importlinter.cli import lint_imports; sys.exit(lint_imports())"


def contract(kind: str) -> dict[str, Any]:
    return next(one for one in CONTRACTS["contracts"] if one["type"] == kind)


def linted(folder: Path, files: dict[str, str]) -> subprocess.CompletedProcess[str]:
    """The answer of import-linter to a room `flights` of these files, under the contract of this repository."""
    for name, text in {"flights/__init__.py": "", **files}.items():
        file = folder / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text, encoding="utf-8")
    circles = contract("acyclic_siblings")
    lines = ["[importlinter]", "root_package = flights", "[importlinter:contract:circles]"]
    lines += [f"{key} = {value}" for key, value in circles.items() if key != "ancestors"]
    lines += ["ancestors =", "    flights"]
    (folder / ".importlinter").write_text("\n".join(lines), encoding="utf-8")
    return subprocess.run([sys.executable, "-c", LINT], cwd=folder, capture_output=True, text=True, check=False)


@pytest.mark.parametrize(
    "files",
    [
        {"flights/flight.py": "from flights import log", "flights/log.py": "from flights.flight import Flight"},
        {
            "flights/flight.py": "import flights.log",
            "flights/log.py": "def read():\n    from flights.units import UNITS\n",
            "flights/units.py": "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    import flights.flight\n",
        },
        {
            "flights/readers/__init__.py": "",
            "flights/readers/csv.py": "from flights.quality import gaps",
            "flights/readers/ulog.py": "",
            "flights/quality/__init__.py": "",
            "flights/quality/gaps.py": "",
            "flights/quality/rates.py": "from flights.readers import ulog",
        },
    ],
    ids=["two modules", "three, inside a function and for types", "two packages without a circle of modules"],
)
def test_a_circle_inside_a_room_is_refused(files: dict[str, str], tmp_path: Path) -> None:
    answer = linted(tmp_path, files)
    assert answer.returncode == 1, answer.stdout + answer.stderr
    assert "No cycles are allowed in flights" in answer.stdout


def test_modules_that_stand_on_each_other_are_not(tmp_path: Path) -> None:
    files = {"flights/flight.py": "from flights import log, units", "flights/log.py": "from flights import units"}
    answer = linted(tmp_path, {**files, "flights/units.py": ""})
    assert answer.returncode == 0, answer.stdout + answer.stderr


def test_every_room_has_the_contract() -> None:
    assert set(contract("acyclic_siblings")["ancestors"]) == set(CONTRACTS["root_packages"])


def circle(imports: dict[str, set[str]]) -> list[str]:
    """Modules each of which imports its predecessor, the first one the last; empty where there is no circle."""
    try:
        TopologicalSorter(imports).prepare()
    except CycleError as error:
        return list(error.args[1])
    return []


@pytest.fixture(scope="module")
def imports() -> dict[str, set[str]]:
    """The modules that each module of this repository imports."""
    graph = grimp.build_graph(*CONTRACTS["root_packages"])
    return {module: graph.find_modules_directly_imported_by(module) for module in graph.modules}


def test_no_module_imports_itself_by_way_of_its_own_package(imports: dict[str, set[str]]) -> None:
    """The contract compares siblings: it takes what a package's own file imports for no import of a sibling."""
    assert circle(imports) == []
    assert circle({**imports, "flights.log": {*imports["flights.log"], "flights"}})


def test_no_room_stands_on_itself_by_way_of_others(imports: dict[str, set[str]]) -> None:
    """Layers name parts of rooms, so that two rooms could stand on each other by different parts."""
    rooms: dict[str, set[str]] = {}
    for module, imported in imports.items():
        room = module.partition(".")[0]
        rooms.setdefault(room, set()).update({one.partition(".")[0] for one in imported} - {room})
    assert circle(rooms) == []
