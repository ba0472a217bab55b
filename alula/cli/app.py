"""The command line: the commands by name, and the exit codes of errors.

A command's module is imported when the command is called. `alula --help` reads the first paragraph of each command's
docstring from its source, so that it starts without numpy, CasADi and MAVLink.
"""

from __future__ import annotations

import ast
import importlib
import inspect
import signal
import sys
import textwrap
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup

from alula import __version__
from alula.cli.escaping import printable
from alula.cli.output import split_output, terminal_width
from dynamics.errors import AlulaError, RequestError
from dynamics.workbench_install import workbench_install

INTERRUPTED = 130  # exit code after Ctrl-C
SUMMARY = "Identifies what a quadrotor's dynamics model is missing, and flies the better model."
OPTIONS = {
    "-v, --verbose": "Versions, time and exit code at the end, the traceback of an error, warnings of libraries.",
    "-q, --quiet": "Errors and JSON alone.",
    "--log-file FILE": "Append everything that is printed to this file, with time, command and exit code.",
    "--version": "Show the version and exit.",
    "--install-completion": "Install completion of commands and options for this shell.",
    "--show-completion": "Show it, to copy or to change it.",
    "-h, --help": "Show this message and exit; alula COMMAND --help shows the options of a command.",
}

COMMANDS = (
    "vehicle",
    "demo",
    "mock",
    "fly",
    "link",
    "doctor",
    "replay",
    "campaign",
    "inspect",
    "scan",
    "compare",
    "diagnose",
    "add",
    "prove",
    "train",
    "evaluate",
    "studio",
    "sweep",
    "export",
    "effects",
    "trust",
)


class LazyGroup(TyperGroup):
    """The commands by name, each imported when it is called."""

    def __init__(self, **attributes: Any) -> None:
        super().__init__(**attributes)
        self.commands = {name: TyperCommand(name) for name in COMMANDS}

    def list_commands(self, ctx: Any) -> list[str]:
        """The commands in the order of use, not of the alphabet."""
        return list(self.commands)

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """The command of a name, imported now."""
        name, command, rest = super().resolve_command(ctx, args)
        return name, load(name) if name in COMMANDS else command, rest

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """The help of the command line, with a line for every command; in plain text, which needs no library."""
        print("\n".join(help_lines(terminal_width())))


def help_lines(width: int) -> Iterator[str]:
    """The help of the command line. width: of a line, characters."""
    yield from ("", " Usage: alula [-v | -q] [--log-file FILE] COMMAND ...", "", f" {SUMMARY}", "")
    for title, rows in (("Options", OPTIONS), ("Commands", {name: summary(name) for name in COMMANDS})):
        yield f"╭─ {title} {'─' * (width - len(title) - 5)}╮"
        column = max(map(len, rows)) + 2
        for name, text in rows.items():
            for place, line in enumerate(textwrap.wrap(" ".join(text.split()), width - column - 4)):
                yield f"│ {name if place == 0 else '':<{column}}{line:<{width - column - 4}} │"
        yield f"╰{'─' * (width - 2)}╯"


def load(name: str) -> Any:
    """The command of a name with its options, or its group of commands."""
    module = importlib.import_module(f"alula.cli.{name}")
    if hasattr(module, "commands"):
        return typer.main.get_group(module.commands)
    single = typer.Typer(add_completion=False)
    single.command(name)(getattr(module, name))
    return typer.main.get_command(single)


def summary(name: str) -> str:
    """The first paragraph of a command's docstring, from its source."""
    source = Path(__file__).with_name(f"{name}.py").read_text(encoding="utf-8")
    functions = (node for node in ast.parse(source).body if isinstance(node, ast.FunctionDef) and node.name == name)
    return inspect.cleandoc(ast.get_docstring(next(functions)) or "").split("\n\n")[0]


app = typer.Typer(
    name="alula",
    cls=LazyGroup,
    help=SUMMARY,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _show_version(requested: bool) -> None:
    if requested:
        print(f"alula {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", is_eager=True, callback=_show_version, help="Show the version and exit.")
    ] = False,
) -> None:
    """Identifies what a quadrotor's dynamics model is missing, and flies the better model."""


def _hear_interrupts() -> None:
    """Let SIGINT end a command that was started in the background, too: a shell's `&` starts it with SIGINT ignored."""
    if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def main() -> None:
    """Run the command line; an error that a user can cause ends with its message and exit code, not a traceback."""
    words, output = split_output(sys.argv[1:])
    sys.argv[1:] = words
    try:
        output.start(words)
    except OSError as error:
        print(f"alula: cannot write the log file {output.log_file!r}: {error.strerror or error}.", file=sys.stderr)
        sys.exit(RequestError.exit_code)
    _hear_interrupts()
    try:
        app()
    except AlulaError as error:
        print(printable(f"alula: {error}"), file=sys.stderr)
        output.finish(error.exit_code, error)
        sys.exit(error.exit_code)
    except SystemExit as end:
        if end.code == INTERRUPTED:
            print("alula: interrupted. Files are written whole or not at all.", file=sys.stderr)
        output.finish(end.code)
        raise
    except ModuleNotFoundError as error:
        advice = f"Commands of the workbench need it: {workbench_install()}."
        print(f"alula: {error.name} is not installed. {advice}", file=sys.stderr)
        output.finish(RequestError.exit_code, error)
        sys.exit(RequestError.exit_code)


if __name__ == "__main__":
    main()
