"""On a flight computer's install the workbench's commands name what to install, and the others still run."""

from __future__ import annotations

import subprocess
import sys

import pytest

WITHOUT = (
    "import sys\n"
    "for name in ('scipy', 'pyarrow', 'plotly', 'jinja2', 'torch'): sys.modules[name] = None\n"
    "sys.argv = ['alula', *{arguments!r}]\n"
    "from alula.cli.app import main\n"
    "main()\n"
)


def run(*arguments: str) -> subprocess.CompletedProcess[str]:
    script = WITHOUT.format(arguments=list(arguments))
    return subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)


@pytest.mark.parametrize("arguments", [("inspect", "some.ulg"), ("campaign", "--out", "nowhere")])
def test_a_command_of_the_workbench_names_what_to_install(arguments: tuple[str, ...]) -> None:
    done = run(*arguments)
    assert done.returncode == 2
    assert "Install alula[workbench]" in done.stderr
    assert "Traceback" not in done.stderr


def test_help_needs_no_workbench() -> None:
    done = run("--help")
    assert done.returncode == 0
    assert "campaign" in done.stdout
