"""`alula trust`: the code that may run here, approved by its content."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

import alula
from alula.api.trusting import Trusted
from alula.cli.output import print_next
from dynamics.approvals import read_approvals, store_path, withdraw
from dynamics.effect_source import printable
from dynamics.errors import RequestError


def trust(
    files: Annotated[
        list[str] | None,
        typer.Argument(
            help="Python files with effects, bundles, or a vehicle file, recording or checkpoint with effects; with "
            "--remove also the beginnings of hashes.",
            metavar="FILE...",
        ),
    ] = None,
    list_them: Annotated[bool, typer.Option("--list", help="Show what is approved.")] = False,
    remove: Annotated[bool, typer.Option("--remove", help="Take these off the list, by file or by hash.")] = False,
) -> None:
    """Approve your own effects, or another machine's bundle, to run here: by content, so a change needs it anew."""
    if list_them and not files and not remove:
        _print_list()
        return
    if not files or list_them:
        raise RequestError("nothing to approve: give FILE..., or --list alone. See docs/trust.md.")
    if remove:
        _remove(files)
        return
    for trusted in alula.trust(files):
        _print(trusted)
    print(f"approved in {store_path()}")
    print_next("trust", "--list")


def _print(trusted: Trusted) -> None:
    """Print an approval; a text without a file of its own whole, since nothing else shows it."""
    held = "" if trusted.carrier is None else f", held by {printable(str(trusted.carrier))}"
    print(f"{trusted.kind} {printable(trusted.name)}{held}\n  sha256 {trusted.sha256}")
    if trusted.carrier is not None:
        for number, line in enumerate(trusted.text.splitlines(), start=1):
            print(f"  {number:>4} | {printable(line)}")


def _print_list() -> None:
    approvals = read_approvals()
    for approval in approvals:
        print(f"{approval.sha256[:16]}  {approval.date}  {approval.kind:8} {printable(approval.name)}")
    if not approvals:
        print("nothing is approved: effects of your own run with `alula trust FILE`, or --effects FILE for one call.")


def _remove(words: list[str]) -> None:
    """Take contents off the list. Raises RequestError where none of them is on it."""
    hashes, names = [word for word in words if not Path(word).exists()], []
    for path in (Path(word) for word in words if Path(word).exists()):
        names.append(str(path.resolve()))
        hashes += _hashes(path)
    removed = withdraw(hashes, names)
    if not removed:
        raise RequestError(f"{', '.join(words)}: not approved, so nothing was removed. `alula trust --list` shows all.")
    for approval in removed:
        print(f"removed {approval.kind} {printable(approval.name)}\n  sha256 {approval.sha256}")


def _hashes(path: Path) -> list[str]:
    """Of a file's present content; none for one that is damaged, which is known by its name alone."""
    from alula.api.trusting import code_in

    try:
        return [trusted.sha256 for trusted in code_in(path)]
    except RequestError:
        return []
