"""Approval of code that may run: effects of a user's own, and bundles of another machine."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from alula.workbench import workbench
from dynamics.errors import RequestError

if TYPE_CHECKING:
    from dynamics.approvals import Kind
    from dynamics.effect_source import EffectFile

RECORDING, CHECKPOINT, VEHICLE_FILE = ".mcap", ".pt", ".toml"


@dataclass(frozen=True)
class Trusted:
    """A content that is approved.

    kind: "effects", Python text, or "bundle".
    name: where it lies, or the name under which `carrier` holds it.
    sha256: of the content.
    text: of effects; empty for a bundle.
    carrier: the recording, checkpoint or vehicle file that holds the text; None for a file of its own.
    """

    kind: Kind
    name: str
    sha256: str
    text: str = ""
    carrier: Path | None = None


def trust(files: str | Path | Sequence[str | Path]) -> tuple[Trusted, ...]:
    """Approve code for good, by its content: it may run as you from now on, wherever a copy of it lies.

    files: Python files with effects, bundles, or what names or carries effects: a vehicle file, a recording (.mcap),
        a checkpoint (.pt). Read them before: nothing runs now, and everything may run later.

    Returns what was approved. Raises RequestError for a file that is none of these, or without effects.

    Example:
        (approved,) = alula.trust("my_effects.py")
        print(approved.name, approved.sha256)
    """
    from dynamics.approvals import approve

    paths = [files] if isinstance(files, (str, Path)) else files
    contents = [trusted for path in paths for trusted in code_in(Path(path))]
    approve((trusted.kind, trusted.sha256, _known_as(trusted)) for trusted in contents)
    return tuple(contents)


def code_in(path: Path) -> list[Trusted]:
    """Code of a file or folder that may run once it is approved. Nothing runs here. Raises RequestError as `trust`."""
    from dynamics.effect_source import ENDING, read_effect_file

    if path.is_dir():
        return [_bundle(path)]
    if path.suffix == ENDING:
        return [_effects(read_effect_file(path))]
    if not path.is_file():
        raise RequestError(f"{path} is neither a file nor a folder. Give a Python file with effects, or a bundle.")
    files = _files_in(path)
    if not files:
        raise RequestError(f"{path} has no effects of your own: there is nothing in it that could run.")
    return [_effects(file, path if file.is_carried else None) for file in files]


def _files_in(path: Path) -> Sequence[EffectFile]:
    """The effect files that a vehicle file names, or that something carries."""
    from dynamics.effect_source import as_carried
    from dynamics.vehicle_file import effect_files_in, vehicle_text

    if path.suffix == VEHICLE_FILE:
        return effect_files_in(vehicle_text(path))
    if path.suffix == RECORDING:
        from runtime.flight_setup import recorded_effect_files
        from runtime.record.recording import read_recording

        return recorded_effect_files(read_recording(path))
    if path.suffix == CHECKPOINT:
        with workbench("alula trust MODEL.pt"):
            from training.checkpoint import read_content
        text = read_content(path).get("vehicle")
        return as_carried(effect_files_in(text)) if isinstance(text, str) else []
    raise RequestError(
        f"{path} is nothing that could run. Give a Python file with effects (.py), a bundle, or what names or carries "
        "effects: a vehicle file (.toml), a recording (.mcap), a checkpoint (.pt)."
    )


def _bundle(folder: Path) -> Trusted:
    from runtime.control.bundle import whole_manifest

    _, sha256 = whole_manifest(folder)
    return Trusted("bundle", str(folder.resolve()), sha256)


def _effects(file: EffectFile, carrier: Path | None = None) -> Trusted:
    return Trusted("effects", file.path, file.sha256, file.text, carrier)


def _known_as(trusted: Trusted) -> str:
    return trusted.name if trusted.carrier is None else f"{trusted.carrier.resolve()}: {trusted.name}"
