"""The whole hour: from PX4's logs to an identified model that flies better, by the public API alone."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.mark.slow
def test_an_hour_leads_from_logs_to_a_vehicle_that_tracks_better(tmp_path: Path) -> None:
    command = [sys.executable, "examples/whole_hour.py", "--out", str(tmp_path / "hour")]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=900, check=False)
    assert done.returncode == 0, done.stderr
    assert "The model misses linear_drag" in done.stdout
    before, after = map(float, re.findall(r"s, ([0-9.]+) m RMS off the reference", done.stdout))
    assert after < 0.5 * before
    assert done.stdout.splitlines()[-1].startswith("whole hour: ")
