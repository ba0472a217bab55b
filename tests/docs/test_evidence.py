"""Figures of docs/evidence.md stand on the page of the benchmark that measured them, under its date and command."""

import re

import pytest

from tests.support.pages import ROOT

EVIDENCE = ROOT / "docs" / "evidence.md"
RESULTS = ROOT / "benchmarks" / "results"
SECTION = re.compile(
    r"^### [^\n]+\n\n\[(\w+)\]\([^)\n]*\): ([\d-]+), commit \w+, [^`\n]+, `([^`\n]+)`\n(.*?)(?=^##|\Z)",
    re.MULTILINE | re.DOTALL,
)
ROW = re.compile(r"^\| (?!what \||---)(.+) \| (.+) \|$", re.M)
NUMBER = r"-?\d[\d,]*(?:\.\d+)?"


def sections() -> list[tuple[str, str, str, str]]:
    """Result page, date, command and rows of each section."""
    return [
        (match[1], match[2], match[3], match[4]) for match in SECTION.finditer(EVIDENCE.read_text(encoding="utf-8"))
    ]


def is_on(page: str, number: str) -> bool:
    """Whether a page has a number, to its last digit; thousands may be separated by commas on either."""
    return re.search(rf"(?<![\d.]){re.escape(number.replace(',', ''))}(?!\d|\.\d)", page.replace(",", "")) is not None


def test_every_section_is_read() -> None:
    headings = re.findall(r"^### ", EVIDENCE.read_text(encoding="utf-8"), re.M)
    assert len(sections()) == len(headings) > 0


@pytest.mark.parametrize(("name", "date", "command", "rows"), sections(), ids=[name for name, *_ in sections()])
def test_figures_are_those_of_the_page(name: str, date: str, command: str, rows: str) -> None:
    page = (RESULTS / f"{name}.md").read_text(encoding="utf-8")
    assert f"Command: `{command}`" in page
    assert date in page
    figures = [figure for _, figure in ROW.findall(rows)]
    assert figures
    numbers = [number for figure in figures for number in re.findall(NUMBER, figure)]
    assert [number for number in numbers if not is_on(page, number)] == []


@pytest.mark.parametrize(("number", "there"), [("0.97", False), ("0.969", True), ("1,558", True), ("55", False)])
def test_a_number_is_found_to_its_last_digit(number: str, there: bool) -> None:
    assert is_on("| all | 0.969 | 2 of 1558 |", number) is there
