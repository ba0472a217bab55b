"""No name of a file and no text of a log reaches the terminal as a command to it."""

from __future__ import annotations

import io
from pathlib import Path

import pytest

from alula.cli.console import Console
from alula.cli.escaping import Escaping, printable
from tests.support.command_line import Run, command_line

NASTY = "a\x1b]0;owned\x07\x1b[2J\u202egnp.exe\x9b31m\rb\u2066"
OBEYED = set(NASTY) - set("a]0;owned[2Jgnp.exe31mb")
CLI = Path(__file__).parents[2] / "alula" / "cli"


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    return command_line(monkeypatch, capsys)


@pytest.mark.parametrize(
    "words",
    [
        ("inspect",),
        ("compare", "--vehicle", "px4_sih"),
        ("diagnose", "--vehicle", "px4_sih"),
        ("diagnose", "x.csv", "--vehicle"),
        ("add", "--vehicle", "px4_sih"),
        ("vehicle", "show"),
        ("vehicle", "from-log"),
        ("replay",),
        ("evaluate",),
        ("fly", "--vehicle", "px4_sih", "--reference"),
        ("fly", "--reference", "hover", "--vehicle"),
        ("effects",),
        ("mock", "--vehicle"),
        ("no-such-command",),
        ("inspect", "--no-such-option"),
    ],
    ids=" ".join,
)
def test_a_command_shows_what_a_terminal_would_obey(words: tuple[str, ...], run: Run, tmp_path: Path) -> None:
    code, shown, wrong = run(*words, tmp_path / f"{NASTY}.csv")
    assert code != 0
    assert not OBEYED & set(shown + wrong)


def test_a_skipped_files_name_is_escaped(run: Run, tmp_path: Path) -> None:
    (tmp_path / f"{NASTY}.txt").write_text("a note")
    (tmp_path / "flight.ulg").write_bytes(b"ULog\x01\x12\x35\x01")
    _, shown, wrong = run("inspect", tmp_path)
    assert "\\x1b]0;owned\\x07" in wrong
    assert not OBEYED & set(shown + wrong)


def test_colours_of_our_own_stay_and_those_of_a_text_do_not() -> None:
    stream = io.StringIO()
    console = Console(file=stream, force_terminal=True, color_system="standard", width=200)
    console.print(f"{NASTY}", style="red", markup=False, highlight=False)
    assert stream.getvalue().count("\x1b") == 2  # red, and its end
    assert "\\x1b]0;owned" in stream.getvalue()


def test_plain_text_stays_as_it_is() -> None:
    text = "Größe 3 µm, 日本語, ✓\tend\n"
    assert printable(text) == text
    stream = io.StringIO()
    assert Escaping(stream).write(text) == len(text)
    assert stream.getvalue() == text


def test_every_command_prints_by_the_escaping_console() -> None:
    texts = {file.name: file.read_text(encoding="utf-8") for file in CLI.glob("*.py")}
    assert [name for name, text in texts.items() if "rich.console import Console\n" in text] == []
