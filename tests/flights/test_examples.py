"""The code of examples/ works as printed; its commands are run with those of all pages."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

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
