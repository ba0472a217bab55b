"""The rule for words that `make lint` enforces refuses what it is meant to, and nothing else."""

import importlib.util
from types import ModuleType

import pytest

from tests.support.pages import ROOT


@pytest.fixture(scope="module")
def rule() -> ModuleType:
    spec = importlib.util.spec_from_file_location("identifiers", ROOT / ".ci" / "identifiers.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize(
    "opening", ["What falls of the error.", "The same of a kind.", "That of a vehicle.", "Those of it."]
)
def test_a_docstring_that_names_nothing_is_refused(rule: ModuleType, opening: str) -> None:
    module = (
        f'"""Words."""\n\n\nclass Error:\n    """{opening}"""\n\n    def of(self):\n        """Error of a kind."""\n'
    )
    [(line, complaint)] = rule.complaints("diagnosis/error.py", module)
    assert line == 5
    assert opening.split()[0] in complaint


@pytest.mark.parametrize("text", ["Whatever is left.", "Thoseby's method.", "A value, the same for all."])
def test_a_docstring_that_names_the_thing_is_not(rule: ModuleType, text: str) -> None:
    assert list(rule.complaints("diagnosis/error.py", f'"""{text}"""\n')) == []


def test_tests_may_begin_as_they_like(rule: ModuleType) -> None:
    assert list(rule.complaints("tests/diagnosis/test_error.py", '"""What is tested."""\n')) == []


@pytest.mark.parametrize("name", ["FIT_FEWEST", "FIT_LARGEST_MOVE", "FIT_LEAST_SHARE", "MOST_ROWS"])
def test_a_superlative_in_a_macro_of_c_is_refused(rule: ModuleType, name: str) -> None:
    [(line, complaint)] = rule.complaints("runtime/control/fit.h", f"#define FIT_ROWS 3\n#define {name} 1 /* rows */\n")
    assert line == 2
    assert name in complaint


def test_variables_of_c_are_read_but_neither_comments_nor_strings(rule: ModuleType) -> None:
    text = '/* the least of\n * LARGEST */\nconst char *text = "MOST"; // fewest\ndouble FIT_MIN_ROWS, least = 0;\n'
    [(line, complaint)] = rule.complaints("runtime/control/fit.c", text)
    assert line == 4
    assert complaint.startswith("least")


def test_a_comment_of_c_names_the_thing_first(rule: ModuleType) -> None:
    [(line, _)] = rule.complaints("runtime/control/fit.h", "#define ROWS 3\n/* The same, in sums. */\n")
    assert line == 2


def test_names_of_python_are_refused_as_before(rule: ModuleType) -> None:
    assert [line for line, _ in rule.complaints("flights/gap.py", "min_gap = 1\nleast_gap = 2\nkept = 3\n")] == [2, 3]
