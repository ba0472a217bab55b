"""README can be followed as it is written, prints what it shows, and stays short."""

import re
from pathlib import Path

import pytest

from tests.support.pages import ROOT
from tests.support.tutorial import blocks, follow, needs_clock, prepare

README = ROOT / "README.md"
MAX_LINES, MAX_CELL = 90, 120
PORT = 14693


@pytest.fixture(scope="session")  # a repeated flight needs no second diagnosis
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a reader who has followed README up to the flight."""
    folder = tmp_path_factory.mktemp("readme")
    prepare(folder)
    follow(README, folder, against_clock=False)
    return folder


@pytest.mark.long("follows the whole page")
def test_its_commands_run_as_written_and_print_what_is_shown(folder: Path) -> None:  # two diagnoses and an addition
    assert (folder / "bundles" / "my_quad" / "manifest.json").exists()


@pytest.mark.long("a flight against the clock, and what it waits for")
@pytest.mark.realtime
def test_its_flight_lands(folder: Path) -> None:
    follow(README, folder, against_clock=True, port=PORT)


def test_an_answer_is_shown_below_a_command() -> None:
    assert any("alula diagnose" in text and shown for _, text, shown in blocks(README))
    assert sum(needs_clock(text) for _, text, _ in blocks(README)) == 1


def test_it_is_one_screen_and_a_half_without_crowded_cells() -> None:
    lines = README.read_text(encoding="utf-8").splitlines()
    assert len(lines) <= MAX_LINES
    cells = [cell.strip() for line in lines if line.startswith("| ") for cell in line.strip("|").split("|")]
    assert [cell for cell in cells if len(cell) > MAX_CELL] == []


def test_its_five_numbers_are_those_of_the_evidence() -> None:
    evidence = (ROOT / "docs" / "evidence.md").read_text(encoding="utf-8")
    section = README.read_text(encoding="utf-8").split("## Five numbers\n")[1].split("\n## ")[0]
    numbers = re.findall(r"^- \[([^\]]+)\]\(docs/evidence\.md#[\w-]+\)", section, re.MULTILINE)
    assert len(numbers) == 5
    assert [number for number in numbers if f"| {number}" not in evidence] == []
