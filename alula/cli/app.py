"""The command line: the commands by name, and how a user's mistakes end."""

from __future__ import annotations

import sys
from typing import Annotated

import typer

from alula import __version__
from alula.cli.add import add
from alula.cli.campaign import campaign
from alula.cli.compare import compare
from alula.cli.demo import demo
from alula.cli.diagnose import diagnose
from alula.cli.evaluate import evaluate
from alula.cli.export import export
from alula.cli.fly import fly
from alula.cli.inspect import inspect
from alula.cli.link import link
from alula.cli.mock import mock
from alula.cli.replay import replay
from alula.cli.sweep import sweep
from alula.cli.train import train
from dynamics.errors import AlulaError, RequestError

app = typer.Typer(
    name="alula",
    help="Makes a quadrotor's flight model true, and flies with it.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _show_version(asked: bool) -> None:
    if asked:
        print(f"alula {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", is_eager=True, callback=_show_version, help="Show the version and exit.")
    ] = False,
) -> None:
    """Makes a quadrotor's flight model true, and flies with it."""


for _command in (
    demo, mock, fly, link, replay, campaign, inspect,
    compare, diagnose, add, train, evaluate, sweep, export,
):  # fmt: skip
    app.command()(_command)


def main() -> None:
    """Run the command line; an error that a user can cause ends with its message and exit code, not a traceback."""
    try:
        app()
    except AlulaError as error:
        print(f"alula: {error}", file=sys.stderr)
        sys.exit(error.exit_code)
    except ModuleNotFoundError as error:
        wanted = f"{error.name} is not installed. Commands of the desk need it: pip install 'alula[workbench]'."
        print(f"alula: {wanted}", file=sys.stderr)
        sys.exit(RequestError.exit_code)


if __name__ == "__main__":
    main()
