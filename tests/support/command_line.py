"""The command line as a user meets it: exit code, what was printed, what was printed as an error."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from alula.cli import app

Run = Callable[..., tuple[int, str, str]]


def command_line(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    """A function that runs `alula` with arguments; what it gives has no line breaks but those between messages."""

    def run(*arguments: str | Path) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["alula", *map(str, arguments)])
        monkeypatch.setenv("COLUMNS", "400")  # sentences in one line each
        with pytest.raises(SystemExit) as caught:
            app.main()
        shown, wrong = capsys.readouterr()
        return int(caught.value.code or 0), shown, wrong

    return run
