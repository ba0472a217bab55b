"""Command lines of a page's actions, and the way from the logs to the present version as a script."""

from __future__ import annotations

import shlex
from pathlib import Path

from dynamics.effect_source import printable
from dynamics.errors import RequestError
from studio.case.case import Case
from studio.case.state import Version
from vehicles import FOLDER as BUNDLED

COMMANDS = {"check": "inspect", "explain": "compare", "fly": "prove"}  # that have another name than their step
HELD_OUT = ("diagnose", "add", "prove", "fly")  # steps that hold flights out


def command(case: Case, step: str, *, effect: str = "", reference: str = "", trial: str = "") -> str:
    """The command line that does the same as a step.

    effect: that is added, the rotor in brackets. reference: that is flown. trial: an effect with values, as
    `alula compare --with` takes it.
    """
    if step == "export":
        return shlex.join(["alula", "export", str(case.vehicle_path()), *_effects(case), "--out", str(_bundle(case))])
    options = case.state.options
    name, _, rotor = effect.partition("[") if step == "add" else ("", "", "")
    words = ["alula", COMMANDS.get(step, step), *filter(None, [name]), *map(str, case.log_paths)]
    if step != "check":
        words += ["--vehicle", _source(case, case.version)]
    if step in ("prove", "fly"):
        words += ["--before", _source(case, case.first_version)]
    words += [*_option("--fly", reference if step == "fly" else ""), *_option("--with", trial), *_effects(case)]
    words += [*_mapping(case), *_system(case)]
    words += _option("--pose", options.pose if step != "check" else "")
    words += _option("--hold-out", options.hold_out if step in HELD_OUT else "")
    return shlex.join([*words, *_option("--rotor", rotor.rstrip("]"))])


def repair_command(case: Case, log: Path) -> str:
    """The command line that writes a mapping file with the repairs of a log, beside where it is run."""
    words = ["alula", "inspect", str(log), *_mapping(case), *_system(case)]
    return shlex.join([*words, "--repair", f"{log.name.partition('.')[0]}_repaired.toml"])


def script(case: Case) -> str:
    """A shell script that goes the way of the present version again: what was undone is not in it.

    It writes into the folder that it is called with, by default `again`. Raises RequestError before a vehicle is
    chosen.
    """
    vehicle = case.vehicle().name
    line = case.line[: case.line.index(case.version) + 1] if case.version else ()
    logs, mapping = shlex.join(map(str, case.log_paths)), _mapping(case)
    lines = [
        "#!/bin/sh",
        f"# {printable(case.state.name)}: from the logs to version {line[-1].number} of {printable(vehicle)}, as the "
        "studio went",
        "set -e",
        'out="${1:-again}"',
        'mkdir -p "$out"',
        _joined("alula inspect", logs, shlex.join([*mapping, *_system(case)])),
    ]
    files: list[str] = []
    for version in line:
        files.append(f'"$out"/{shlex.quote(f"{vehicle}.v{version.number}.toml")}')
        words = _own_words(case, version)
        if version.parent:
            lines.append(_joined(shlex.join(_without(words, "--vehicle")), "--vehicle", files[-2], "--out", files[-1]))
        elif words:
            lines.append(_joined(shlex.join(_without(words, "--out")), "--out", files[-1]))
        else:
            files[-1] = shlex.quote(_source(case, version))
    if len(files) > 1:
        read = shlex.join([*_effects(case), *mapping, *_system(case), *_option("--pose", case.state.options.pose)])
        held = shlex.join(_option("--hold-out", case.state.options.hold_out))
        lines.append(_joined("alula prove", logs, "--vehicle", files[-1], "--before", files[0], read, held))
    return "\n".join(lines) + "\n"


def _own_words(case: Case, version: Version) -> list[str]:
    """The command that made a version, as words: one of Alula's, with the case's own effects and no others.

    Raises RequestError for another one: a case that was sent is data, and its script will be run.
    """
    words = shlex.split(version.command)
    if words and (words[0] != "alula" or words[1:2] not in (["add"], ["vehicle"])):
        raise RequestError(
            f"version {version.number} says that it was made by {printable(version.command)!r}, which is no command "
            "that the studio gives: the case was edited. No script is made of it."
        )
    if not any(word.startswith("--effects") for word in words):
        return words
    while "--effects" in words:
        words = _without(words, "--effects")
    return [*(word for word in words if not word.startswith("--effects=")), *_effects(case)]


def _source(case: Case, version: Version | None) -> str:
    """A version as `--vehicle` takes it: the name of a bundled vehicle, else the version's file."""
    is_bundled = case.state.vehicle in {path.stem for path in BUNDLED.glob("*.toml")}
    return case.state.vehicle if version and not version.parent and is_bundled else str(case.vehicle_path(version))


def _bundle(case: Case) -> Path:
    number = case.version.number if case.version else 0
    return case.folder / f"{case.vehicle_name()}.v{number}.bundle"


def _effects(case: Case) -> list[str]:
    return [word for file in case.effect_files() for word in ("--effects", file.path)]


def _mapping(case: Case) -> list[str]:
    return _option("--mapping", str(case.mapping_path or ""))


def _system(case: Case) -> list[str]:
    return _option("--system", case.state.options.system)


def _option(name: str, value: str) -> list[str]:
    return [name, value] if value else []


def _without(words: list[str], option: str) -> list[str]:
    """Words without an option and its value."""
    place = words.index(option)
    return words[:place] + words[place + 2 :]


def _joined(*parts: str) -> str:
    """Parts of a line that are shell already, empty ones left out."""
    return " ".join(part for part in parts if part)
