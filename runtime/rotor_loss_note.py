"""A note beside the recordings that a rotor lost thrust: the next flight is refused until somebody has looked at it."""

from __future__ import annotations

from pathlib import Path

from dynamics.errors import VehicleError


def note_path(folder: Path, vehicle: str) -> Path:
    """Where the note of a vehicle lies. folder: of its recordings."""
    return folder / f"{vehicle}.rotor_loss.txt"


def write_note(folder: Path, vehicle: str, text: str) -> Path:
    """Write the note. text: which rotor lost how much, and when."""
    path = note_path(folder, vehicle)
    path.write_text(f"{text}\n", encoding="utf-8")
    return path


def require_no_note(folder: Path | None, vehicle: str) -> None:
    """Raises VehicleError where a flight that was recorded in the folder ended with a rotor that had lost thrust."""
    if folder is None or not (path := note_path(folder, vehicle)).is_file():
        return
    raise VehicleError(
        f"{vehicle} does not take off: {path.read_text(encoding='utf-8').strip()}. Replace the propeller or the motor, "
        f"then delete {path}."
    )
