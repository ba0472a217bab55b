"""A note beside the recordings that a rotor lost thrust: the next flight is refused until somebody has looked at it."""

from __future__ import annotations

from pathlib import Path

from dynamics.errors import RequestError, VehicleError
from dynamics.files import write_whole


def note_path(folder: Path, vehicle: str) -> Path:
    """Where the note of a vehicle lies. folder: of its recordings."""
    return folder / f"{vehicle}.rotor_loss.txt"


def write_note(folder: Path, vehicle: str, text: str) -> Path:
    """Write the note. text: which rotor lost how much, and when. Raises RequestError where it cannot be written."""
    return write_whole(
        note_path(folder, vehicle),
        lambda part: part.write_text(f"{text}\n", encoding="utf-8"),
        advice="Look at the propeller before the next flight.",
    )


def leave_note(folder: Path | None, vehicle: str, text: str) -> str:
    """Write the note at the end of a flight, where that can be done. Returns what is to be announced of it.

    folder: of the recordings, None where the flight was not recorded.
    """
    if folder is None:
        return f"the next take-off is NOT refused, since nothing was recorded: {text}"
    try:
        return f"no take-off until {write_note(folder, vehicle, text)} is deleted"
    except RequestError as error:
        return f"the next take-off is NOT refused: {error}"


def require_no_note(folder: Path | None, vehicle: str) -> None:
    """Raises VehicleError where a flight that was recorded in the folder ended with a rotor that had lost thrust."""
    if folder is None or not (path := note_path(folder, vehicle)).is_file():
        return
    raise VehicleError(
        f"{vehicle} does not take off: {path.read_text(encoding='utf-8').strip()}. Replace the propeller or the motor, "
        f"then delete {path}."
    )
