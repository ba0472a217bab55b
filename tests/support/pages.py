"""Pages that a reader of the documentation follows, and the commands that they show."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[2]
TUTORIALS = ROOT / "docs" / "tutorials"  # are followed whole, by tests of their own
PAGES = sorted(
    [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").rglob("*.md"), *(ROOT / "examples").glob("*.md")]
)
UNITS = sorted((ROOT / "examples").rglob("*.service"))
FENCED = re.compile(r"^```(\w*)\n(.*?)^```", re.MULTILINE | re.DOTALL)
INDENTED = re.compile(r"^(?: {4}.*\n?)+", re.MULTILINE)
ASSIGNMENT = re.compile(r'^(\w+)="(.*)"$')
COMMAND = re.compile(
    r"^(?:\$ )?(?:# shorter: )?(?:\.?venv/bin/)?(?:python -m )?(?:torchrun [^\n]*-m )?(alula .*?)(?: &)?$"
)


class PageCommand(NamedTuple):
    """A command of a page. text: from `alula` on, with variables of the shell replaced."""

    page: str
    text: str


def shell_lines(page: Path) -> Iterator[str]:
    """Lines of blocks that are no Python, continued lines joined, variables replaced by what the block sets them to."""
    text = page.read_text(encoding="utf-8")
    blocks = [body for language, body in FENCED.findall(text) if language in ("", "sh", "bash")]
    blocks += INDENTED.findall(FENCED.sub("", text))
    for block in blocks:
        variables: dict[str, str] = {}
        for line in (line.strip() for line in block.replace("\\\n", " ").splitlines()):
            for name, value in variables.items():
                line = line.replace(f"${name}", value)
            if assignment := ASSIGNMENT.match(line):
                variables[assignment[1]] = assignment[2]
            yield line


def commands_in_blocks() -> list[PageCommand]:
    """Every command in a block, in the order of the pages."""
    matches = ((page, COMMAND.match(line)) for page in PAGES for line in shell_lines(page))
    return [PageCommand(page.name, match[1]) for page, match in matches if match]


def commands_of_units() -> list[PageCommand]:
    """What the units of examples/deploy start, without the folder of the program."""
    lines = ((unit, unit.read_text(encoding="utf-8").replace("\\\n", " ")) for unit in UNITS)
    return [
        PageCommand(unit.name, start)
        for unit, text in lines
        for start in re.findall(r"^ExecStart=\S*/(alula .*)$", text, re.MULTILINE)
    ]


def commands_in_sentences() -> list[PageCommand]:
    """Every command between backticks, which may leave arguments out."""
    texts = ((page, FENCED.sub("", page.read_text(encoding="utf-8"))) for page in PAGES)
    return [PageCommand(page.name, text) for page, body in texts for text in re.findall(r"`(alula [^`]+)`", body)]
