"""The command line: the commands by name, and the exit codes of errors.

A command's module is imported when the command is called. `alula --help` reads the first paragraph of each command's
docstring from its source, so that it starts without numpy, CasADi and MAVLink.
"""

from __future__ import annotations

import ast
import importlib
import inspect
import sys
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup

from alula import __version__
from dynamics.errors import AlulaError, RequestError

INTERRUPTED = 130  # exit code after Ctrl-C

COMMANDS = (
    "vehicle",
    "demo",
    "mock",
    "fly",
    "link",
    "replay",
    "campaign",
    "inspect",
    "compare",
    "diagnose",
    "add",
    "train",
    "evaluate",
    "sweep",
    "export",
    "effects",
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
        """The help of the command line, with a line for every command."""
        for name, command in self.commands.items():
            command.help = command.help or summary(name)
        super().format_help(ctx, formatter)


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
    help="Identifies what a quadrotor's dynamics model is missing, and flies the better model.",
    no_args_is_help=True,
    add_completion=False,
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


def main() -> None:
    """Run the command line; an error that a user can cause ends with its message and exit code, not a traceback."""
    try:
        app()
    except AlulaError as error:
        print(f"alula: {error}", file=sys.stderr)
        sys.exit(error.exit_code)
    except SystemExit as end:
        if end.code == INTERRUPTED:
            print("alula: interrupted. Files are written whole or not at all.", file=sys.stderr)
        raise
    except ModuleNotFoundError as error:
        advice = "Commands of the workbench need it: pip install 'alula[workbench]'."
        print(f"alula: {error.name} is not installed. {advice}", file=sys.stderr)
        sys.exit(RequestError.exit_code)


if __name__ == "__main__":
    main()
