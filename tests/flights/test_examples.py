"""The commands and code of examples/ work as printed."""

from __future__ import annotations

import re
import shlex
import sys
from pathlib import Path

import pytest

from alula.cli import app
from flights import Flight
from tests.support.flight_files import manoeuvre, paper_bag

EXAMPLES = Path(__file__).parents[2] / "examples"


def test_the_papers_bags_in_five_lines(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (code,) = re.findall(r"```python\n(.*?)```", (EXAMPLES / "paper_bags.md").read_text(), flags=re.DOTALL)
    assert len([line for line in code.splitlines() if line.strip()]) <= 5
    paper_bag(manoeuvre(), tmp_path / "Ellipse_1.bag")
    monkeypatch.chdir(tmp_path)
    exec(compile(code, "paper_bags.md", "exec"), {})
    assert "a bag of the paper's set" in capsys.readouterr().out
    assert Flight.read(tmp_path / "Ellipse_1.csv").has("position", "velocity", "attitude", "rate", "rotor_speed")


def test_table_i_from_the_papers_bags(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With five steps of training instead of 10,000 epochs."""
    (text,) = re.findall(r"```sh\n(.*?)```", (EXAMPLES / "paper_bags.md").read_text(), flags=re.DOTALL)
    commands = [shlex.split(line) for line in text.splitlines()]
    assert len(commands) == 5
    for seconds, name in enumerate(("train/Ellipse_1_slow", "train/Lemniscate_xz", "train/line", "test/Ellipse_1")):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        paper_bag(manoeuvre(duration=10.0 + seconds), tmp_path / f"{name}.bag")
    monkeypatch.chdir(tmp_path)
    for command in commands:
        brief = ["--steps", "5"] if command[1] == "train" else ["--no-timing"]
        monkeypatch.setattr(sys, "argv", [*command, *brief])
        with pytest.raises(SystemExit) as ended:
            app.main()
        assert not ended.value.code
    assert "Ellipse_1" in (tmp_path / "table_1.html").read_text()
    assert list((tmp_path / "table_1").glob("*.csv"))
