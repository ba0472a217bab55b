"""The command line as a user meets it: help, version, and how mistakes end."""

import os
import re
import subprocess
import sys
from importlib import metadata

import pytest
import typer

from alula import __version__
from alula.cli import app
from dynamics.errors import AlulaError, DataError, RequestError, VehicleError


@pytest.fixture
def run(monkeypatch, capsys):
    """Run the command line; returns exit code, standard output, standard error."""

    def ended(*arguments):
        monkeypatch.setattr(sys, "argv", ["alula", *arguments])
        with pytest.raises(SystemExit) as caught:
            app.main()
        return caught.value.code, *capsys.readouterr()

    return ended


def test_help_names_every_command_in_one_line(run):
    code, shown, _ = run("--help")
    assert code == 0
    for name in app.COMMANDS:
        assert re.search(rf"^│ {name} +[A-Z]", shown, re.MULTILINE), name


@pytest.mark.parametrize("name", app.COMMANDS)
def test_the_line_of_a_command_is_the_beginning_of_its_own_help(name):
    command = app.load(name)
    assert command.help.startswith(app.summary(name))
    assert command.callback.__name__ == name


def test_a_command_that_is_misspelt_gets_the_nearest_one(run):
    code, _, message = run("diagnos")
    assert code == 2
    assert "diagnose" in message


HELP = """
import sys
from alula.cli.app import main
sys.argv = ['alula', '--help']
try:
    main()
except SystemExit:
    print([m for m in sys.modules if m in ('numpy', 'casadi', 'msgspec', 'pymavlink', 'flights', 'runtime')])
"""


def test_help_imports_no_commands_room():
    done = subprocess.run([sys.executable, "-c", HELP], capture_output=True, text=True, timeout=250, check=True)
    assert done.stdout.splitlines()[-1] == "[]"


def test_version_is_the_distributions():
    done = subprocess.run([sys.executable, "-m", "alula", "--version"], capture_output=True, text=True, check=True)
    assert done.stdout == f"alula {__version__}\n"
    assert metadata.version("alula") == __version__


@pytest.mark.parametrize("arguments", [["flie"], ["--bogus"], ["mock", "--vehicel", "x"], ["mock"]])
def test_what_the_command_line_does_not_know_is_a_wrong_request(run, arguments):
    code, _, message = run(*arguments)
    assert code == 2
    assert arguments[0] in message


def test_a_file_that_is_not_there_ends_with_a_message_and_code_2(run, tmp_path):
    code, _, message = run("mock", "--vehicle", str(tmp_path / "absent.toml"))
    assert code == 2
    assert "there is no vehicle file" in message


@pytest.mark.parametrize(("error", "code"), [(RequestError, 2), (DataError, 3), (VehicleError, 4), (AlulaError, 1)])
def test_each_kind_of_error_has_its_exit_code(run, error, code, monkeypatch):
    failing = typer.Typer()

    @failing.command()
    def fail() -> None:
        raise error("the reason")

    monkeypatch.setattr(app, "app", failing)
    assert run() == (code, "", "alula: the reason\n")


def test_a_recording_that_is_not_there_is_a_wrong_request(run):
    code, _, message = run("replay", "nothere.mcap")
    assert code == 2
    assert "cannot read nothere.mcap" in message


def test_a_workbench_command_on_a_flight_computer_names_what_to_install(run, monkeypatch):
    workbench = typer.Typer()

    @workbench.command()
    def study() -> None:
        raise ModuleNotFoundError("No module named 'pyarrow'", name="pyarrow")

    monkeypatch.setattr(app, "app", workbench)
    code, _, message = run()
    assert code == 2
    assert "pyarrow is not installed" in message
    assert "[workbench]'" in message


def test_an_interrupt_is_reported_without_a_traceback(run, monkeypatch):
    interrupted = typer.Typer()

    @interrupted.command()
    def wait() -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(app, "app", interrupted)
    assert run() == (130, "", "alula: interrupted. Files are written whole or not at all.\n")


def test_starting_imports_nothing_of_the_workbench():
    code = (
        "import sys; from alula.cli import app; [app.load(name) for name in app.COMMANDS]; "
        "print([m for m in ('torch', 'scipy', 'matplotlib') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=250, check=True)
    assert done.stdout.strip() == "[]"


def test_numerical_libraries_use_one_thread_each() -> None:
    code = (
        "import sys, alula, runtime.realtime; early = 'numpy' in sys.modules; import os, alula.__main__; "
        "print(early, os.environ['OPENBLAS_NUM_THREADS'])"
    )
    without = {name: value for name, value in os.environ.items() if not name.endswith("_NUM_THREADS")}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, env=without)
    assert done.stdout.split() == ["False", "1"]
