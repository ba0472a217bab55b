"""On a flight computer's install the workbench's commands name what to install, and the others still run."""

from __future__ import annotations

import subprocess
import sys

import pytest

ABSENT = (
    *("casadi", "onnxruntime", "scipy", "pyarrow", "plotly", "jinja2", "torch", "matplotlib", "onnx", "optuna"),
    *("pyulog", "rosbags"),
)
WITHOUT = """
import sys
for name in {absent!r}:
    sys.modules[name] = None
sys.argv = ["alula", *{arguments!r}]
from alula.cli.app import main
main()
"""


def run(*arguments: str) -> subprocess.CompletedProcess[str]:
    script = WITHOUT.format(absent=ABSENT, arguments=list(arguments))
    return subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)


@pytest.mark.parametrize(
    "arguments",
    [
        ("inspect", "some.ulg"),
        ("compare", "some.ulg", "--vehicle", "arpl_250g"),
        ("diagnose", "some.ulg", "--vehicle", "arpl_250g"),
        ("add", "some.ulg", "--vehicle", "arpl_250g"),
        ("train", "some.ulg", "--vehicle", "arpl_250g", "--model", "pi_tcn", "--out", "m.pt"),
        ("evaluate", "m.pt", "some.ulg"),
        ("export", "m.pt", "--out", "bundle"),
        ("sweep", "kinds", "some.ulg", "--vehicle", "arpl_250g", "--out", "nowhere"),
        ("campaign", "--out", "nowhere"),
        ("mock", "--vehicle", "px4_sih"),
        ("demo", "--out", "nowhere"),
    ],
)
def test_a_command_of_the_workbench_names_what_to_install(arguments: tuple[str, ...]) -> None:
    done = run(*arguments)
    assert done.returncode == 2
    assert "[workbench]'" in done.stderr
    assert "Traceback" not in done.stderr


def test_help_needs_no_workbench() -> None:
    done = run("--help")
    assert done.returncode == 0
    assert "campaign" in done.stdout
