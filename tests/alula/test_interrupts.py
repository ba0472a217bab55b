"""An interrupt ends a command that computes for long, soon after it and with its exit code, from wherever it comes."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from alula.cli.app import INTERRUPTED

LOGS = sorted(Path("tests/data/px4_sih_flights").resolve().glob("*_[12]_*.ulg.gz"))
FROM_LOG = ("vehicle", "from-log", *map(str, LOGS), "--name", "v", "--mass", "1", "--arm", "0.28")
CAMPAIGN = ("campaign", "--out", "campaign", "--jobs", "2")
# says when a function begins, as a bar does on a terminal
BEGINNING = """
import sys, {module} as module
begin = module.{name}
def beginning(*values, **options):
    print("begun", flush=True)
    return begin(*values, **options)
module.{name} = beginning
sys.argv[0] = "alula"
from alula.__main__ import main
if __name__ == "__main__":
    main()
"""
MANY_TIMES = 60.0  # s, below which it ends; on an idle machine within 2 s, and the work takes minutes


@pytest.mark.parametrize(
    ("words", "module", "name"),
    [
        (FROM_LOG, "diagnosis.vehicle_from_logs", "read_flights"),
        (FROM_LOG, "diagnosis.vehicle_from_logs", "identify_vehicle"),
        (CAMPAIGN, "simulation.campaign", "parallel_map"),
    ],
)
def test_an_interrupt_ends_the_command(words: tuple[str, ...], module: str, name: str, tmp_path: Path) -> None:
    script = tmp_path / "begin.py"
    script.write_text(BEGINNING.format(module=module, name=name))
    with subprocess.Popen(
        [sys.executable, script, *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(Path.cwd())},
    ) as process:
        assert process.stdout is not None
        assert any(line == "begun\n" for line in process.stdout)
        process.send_signal(signal.SIGINT)
        began = time.monotonic()
        _, wrong = process.communicate(timeout=MANY_TIMES)
        taken = time.monotonic() - began
    assert process.returncode == INTERRUPTED, wrong
    assert "interrupted" in wrong
    assert "Traceback" not in wrong
    assert taken < MANY_TIMES
    assert not (tmp_path / "v.toml").exists()
    assert not (tmp_path / "campaign" / "manifest.json").exists()
