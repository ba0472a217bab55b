"""What README and docs show can be run: commands are parsed by the command line itself, Python is executed.

Commands in blocks are parsed whole, with their arguments; `test_commands_of_pages.py` runs them. Those within
sentences may leave arguments out, so that only the command and its options are looked up. Python runs in a folder with
a few short flights; functions that take minutes or a vehicle (train, evaluate, export, fly) are replaced by their own
signatures.
"""

from __future__ import annotations

import inspect
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any
from unittest.mock import MagicMock

import pytest

import alula
from alula.cli import app
from dynamics.vehicle import Vehicle
from dynamics.vehicle_file import write_vehicle
from tests.support.pages import (
    FENCED,
    PAGES,
    ROOT,
    TUTORIALS,
    commands_in_blocks,
    commands_in_sentences,
    commands_of_units,
    shell_lines,
)
from tests.support.reader_folder import HIDDEN, heavier, hovering_logs, planted_logs
from tests.support.small_campaign import fly_campaign

SLOW = (
    "train",
    "evaluate",
    "export",
    "verify",
    "plan_flight",
    "fly",
    "vehicle_from_logs",
    "check_vehicle",
    "add_from_flight",
)  # or need a bundle, a log


def python_blocks() -> list[Any]:
    blocks = (
        (page, body)
        for page in PAGES
        if page.parent != TUTORIALS
        for language, body in FENCED.findall(page.read_text(encoding="utf-8"))
        if language == "python"
    )
    return [pytest.param(body, id=f"{page.stem}-{place}") for place, (page, body) in enumerate(blocks)]


def command_of(name: str, words: list[str]) -> Any:
    """The command of a name; of a group the one that the first word names, which is taken off."""
    command = app.load(name)
    return command.commands[words.pop(0)] if words and words[0] in getattr(command, "commands", {}) else command


@pytest.mark.parametrize(("page", "command"), [*commands_in_blocks(), *commands_of_units()])
def test_a_command_in_a_block_is_taken_by_the_command_line(
    page: str, command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for own in ("MINE.py", "my_effects.py"):  # read with the options, as naming it approves its content
        shutil.copy(ROOT / "examples" / "my_effects.py", own)
    name, *arguments = shlex.split(command, comments=True)[1:]
    if "..." in arguments:  # stands for what a line above shows
        test_a_command_in_a_sentence_exists_with_its_options(page, command)
        return
    assert name in app.COMMANDS, page
    command_of(name, arguments).make_context(
        name, arguments
    )  # raises for an unknown option, a missing argument, a wrong type


@pytest.mark.parametrize(("page", "command"), commands_in_sentences())
def test_a_command_in_a_sentence_exists_with_its_options(page: str, command: str) -> None:
    name, *words = shlex.split(command, comments=True)[1:]
    if name == "COMMAND" or any(name in shown for shown in app.OPTIONS):
        return
    assert name in app.COMMANDS, page
    options = {
        option
        for parameter in command_of(name, words).params
        for option in (*parameter.opts, *parameter.secondary_opts)
    }
    assert {word.split("=")[0] for word in words if word.startswith("--")} <= options | {"--help"}, page


def test_a_target_of_make_exists() -> None:
    targets = set(re.findall(r"^([\w.-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))
    shown = {line.split()[1] for page in PAGES for line in shell_lines(page) if re.match(r"make [a-z]+\b", line)}
    assert shown
    assert shown <= targets | {"px4_sitl"}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_to_files_lead_somewhere(page: Path) -> None:
    links = re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", page.read_text(encoding="utf-8"))
    assert [link for link in links if not (page.parent / link).exists()] == []


def test_every_page_is_in_the_menu_of_the_site() -> None:
    menu = (ROOT / "mkdocs.yml").read_text(encoding="utf-8").split("\nnav:\n")[1]
    pages = {page.relative_to(ROOT / "docs").as_posix() for page in (ROOT / "docs").rglob("*.md")}
    assert pages - set(re.findall(r"(\S+\.md)$", menu, re.MULTILINE)) == set(), "add them to nav in mkdocs.yml"


MADE_PAGES = ("make_api", "make_catalogue", "make_flight_rules", "make_licences")


@pytest.mark.parametrize("script", [f"docs/{name}.py" for name in MADE_PAGES])
def test_a_page_that_is_made_from_the_code_is_up_to_date(script: str) -> None:
    command = [sys.executable, script, "--check"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"run: python {script}\n{done.stderr}"


@pytest.fixture(scope="module")
def flights(arpl_250g: Vehicle, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with what the snippets name: logs, vehicle files, a campaign, models."""
    folder = tmp_path_factory.mktemp("snippets")
    planted_logs(folder / "logs", arpl_250g)
    hovering_logs(folder / "hover")
    for name in ("log.ulg", "Ellipse_1.bag"):  # the content decides which format it is
        shutil.copy(folder / "logs" / "flight_0.csv", folder / name)
    for name in ("heavy.toml", "my_quad.toml", "my_quad.v2.toml"):
        write_vehicle(heavier(arpl_250g), folder / name)
    (folder / "fleet.toml").write_text("[search]\nmin_gain = 60.0\n")
    (folder / "vehicles").symlink_to(ROOT / "vehicles")
    shutil.copy(ROOT / "examples" / "my_effects.py", folder)
    fly_campaign(folder / "build" / "campaign_learning", arpl_250g, HIDDEN, {"test/Line": "line:laps=3,ramp=1"})
    return folder


@pytest.mark.parametrize("code", python_blocks())
def test_python_runs(code: str, flights: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    shutil.copytree(flights, tmp_path / "here", symlinks=True)
    monkeypatch.chdir(tmp_path / "here")
    for name in SLOW:
        monkeypatch.setattr(alula, name, signature_of(getattr(alula, name)))
    exec(compile(code, "snippet", "exec"), {})


def signature_of(function: Any) -> Any:
    """A function that takes what another takes, and does nothing."""
    signature = inspect.signature(function)

    def stand_in(*arguments: Any, **options: Any) -> MagicMock:
        signature.bind(*arguments, **options)
        return MagicMock()

    return stand_in
