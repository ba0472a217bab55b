"""Mutants change one thing each, are the same in two versions of a source, and live or die by the tests."""

import ast
import json
import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks.mutation import tree_worker
from benchmarks.mutation.mutants import mutants
from benchmarks.mutation.tests_kill import imported_modules

SOURCE = '''"""A module."""

LIMIT: Literal[3] = 3


@decorated(limit=4)
def share(parts: list[float], *, of: float = 2.0) -> float:
    """Of 1 part."""
    if not parts and of <= 0 or LIMIT is None:
        raise ValueError(f"{len(parts) + 1} parts")
    return -sum(parts) / of
'''


def test_all_kinds_of_change_are_made() -> None:
    replaced = {(expression, becomes) for _, _, expression, becomes, _ in mutants(SOURCE)}
    assert replaced == {
        ("3", "(4)"),
        ("2.0", "(4.0)"),
        ("not parts and of <= 0 or LIMIT is None", "((not parts and of <= 0) and LIMIT is None)"),
        ("not parts and of <= 0", "(not parts or of <= 0)"),
        ("not parts", "(parts)"),
        ("of <= 0", "(of < 0)"),
        ("0", "(1)"),
        ("LIMIT is None", "(LIMIT is not None)"),
        ("return -sum(parts) / of", "return None"),
        ("-sum(parts) / of", "(-sum(parts) * of)"),
        ("-sum(parts)", "(sum(parts))"),
    }


def test_a_mutant_is_a_program_that_differs() -> None:
    programs = [ast.dump(ast.parse(mutated)) for mutated in mutants(SOURCE).values()]
    assert len({ast.dump(ast.parse(SOURCE)), *programs}) == 1 + len(programs)


def test_places_count_bytes() -> None:
    (mutated,) = mutants('name = "Größe", 2\n').values()
    assert mutated == 'name = "Größe", (3)\n'


def test_lines_that_move_keep_their_mutants() -> None:
    moved = SOURCE.replace("LIMIT: ", "import math\n\nLIMIT: ").replace("of <= 0", "of <= 1")
    common = set(mutants(SOURCE)) & set(mutants(moved))
    assert {line for _, line, *_ in common} == {
        "LIMIT: Literal[3] = 3",
        "def share(parts: list[float], *, of: float = 2.0) -> float:",
        "return -sum(parts) / of",
    }


def test_equal_expressions_of_a_line_are_apart() -> None:
    assert sorted(mutants("a = 1 + 1\n").values()) == ["a = (1 - 1)\n", "a = (2) + 1\n", "a = 1 + (2)\n"]


def test_imports_are_found_anywhere() -> None:
    source = "import a.b\n\ndef f():\n    from c import d, e as g\n"
    assert imported_modules(source) == {"a.b", "c", "c.d", "c.e"}


@pytest.mark.parametrize(
    ("code", "killed"),
    [("value = 1", False), ("value = 2", True), ("value =", True), ("while True:\n    pass", True)],
    ids=["right", "wrong", "no program", "without end"],
)
def test_a_module_is_killed_by_its_tests_or_by_time(tmp_path: Path, code: str, killed: bool) -> None:
    (tmp_path / "pytest.ini").write_text(
        "[pytest]\npythonpath = .\naddopts = -p no:dash\nmarkers =\n    slow\n    realtime\n"
    )
    (tmp_path / "module.py").write_text(f"{code}\n")
    (tmp_path / "test_module.py").write_text("def test_value():\n    from module import value\n    assert value == 1\n")
    limit = 6 if "while" in code else 60
    request = {"module": "module", "tests": ["test_module.py"], "limit": limit, "writes_bytecode": False}
    answered = subprocess.run(
        [sys.executable, tree_worker.__file__],
        input=json.dumps(request) + "\n",
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=True,
    )
    code_of_tests, seconds = json.loads(answered.stdout)
    assert (code_of_tests != 0) is killed
    assert 0 < seconds < limit + 2
    assert not list(tmp_path.rglob("module.*.pyc"))
