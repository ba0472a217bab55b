"""The command line as a user meets it: help, version, and how mistakes end."""

import subprocess
import sys

import pytest
import typer

from alula import __version__, cli
from dynamics.errors import AlulaError, DataError, RequestError, VehicleError


def run(*arguments):
    """The command line in a process of its own."""
    command = [sys.executable, "-m", "alula", *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)


def test_help_names_every_command_in_one_line():
    shown = run("--help").stdout
    for command in cli.app.registered_commands:
        assert command.callback.__doc__
        assert command.callback.__name__ in shown


def test_version_is_the_distributions():
    assert run("--version").stdout == f"alula {__version__}\n"


@pytest.mark.parametrize("arguments", [["flie"], ["--bogus"], ["mock", "--vehicel", "x"], ["mock"]])
def test_what_the_command_line_does_not_know_is_a_wrong_request(arguments):
    done = run(*arguments)
    assert done.returncode == 2
    assert "Traceback" not in done.stderr
    assert arguments[0] in done.stderr


def test_a_file_that_is_not_there_ends_with_a_message_and_code_2(tmp_path):
    done = run("mock", "--vehicle", str(tmp_path / "absent.toml"))
    assert done.returncode == 2
    assert "cannot read the vehicle file" in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize(("error", "code"), [(RequestError, 2), (DataError, 3), (VehicleError, 4), (AlulaError, 1)])
def test_each_kind_of_error_has_its_exit_code(error, code, monkeypatch, capsys):
    failing = typer.Typer()

    @failing.command()
    def fail() -> None:
        raise error("what was wanted")

    monkeypatch.setattr(cli, "app", failing)
    monkeypatch.setattr(sys, "argv", ["alula"])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert ended.value.code == code
    assert capsys.readouterr().err == "alula: what was wanted\n"


def test_an_interrupt_ends_without_a_traceback(monkeypatch, capsys):
    interrupted = typer.Typer()

    @interrupted.command()
    def wait() -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(cli, "app", interrupted)
    monkeypatch.setattr(sys, "argv", ["alula"])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert ended.value.code == 130
    assert "Traceback" not in capsys.readouterr().err


def test_starting_imports_nothing_of_the_desk():
    code = "import sys, alula.cli; print([m for m in ('torch', 'scipy', 'matplotlib') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout.strip() == "[]"
