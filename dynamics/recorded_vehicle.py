"""The vehicle that is read from a recording of several: the first autopilot, or the one that was chosen.

A choice holds for the process, as a call's approvals do, and for the processes that do part of its work: a command
reads its logs in many places, and reads one vehicle in all of them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from dynamics.autopilot import first_vehicle
from dynamics.errors import RequestError

Address = tuple[int, int]  # system and component
Announce = Callable[[str], None]
MAX_SYSTEM = 255


class _Choice:
    def __init__(self) -> None:
        self.system: int | None = None
        self.announce: Announce | None = None
        self.announced: set[str] = set()


_choice = _Choice()


def choose_system(system: int | None, announce: Announce | None = None) -> None:
    """Read the vehicle with a system id from now on, None for the first autopilot of each recording.

    announce: called with a line for each recording of several vehicles, once.
    """
    _choice.system, _choice.announce, _choice.announced = system, announce, set()


@contextmanager
def system_chosen(system: int | None) -> Iterator[None]:
    """Read the vehicle with a system id inside of the block; None leaves the choice of the process as it is.

    Raises RequestError for a number that no MAVLink system has.
    """
    if system is None:
        yield
        return
    if isinstance(system, bool) or not isinstance(system, int) or not 1 <= system <= MAX_SYSTEM:
        raise RequestError(f"system = {system!r} is no system id. Give a whole number, 1 to {MAX_SYSTEM}.")
    process_wide, _choice.system = _choice.system, system
    try:
        yield
    finally:
        _choice.system = process_wide


def chosen_system() -> int | None:
    """The system id that was chosen in this process."""
    return _choice.system


def recorded_vehicle(path: Path, autopilots: list[Address], frames: Mapping[Address, int]) -> tuple[Address, str]:
    """The address of the vehicle to read, and a note on the choice, empty where there was none.

    autopilots: senders of an autopilot's heartbeat, in order. frames: how many each sender sent, at least one sender.
    Raises RequestError where the chosen system is not among them.
    """
    system = _choice.system
    vehicle = first_vehicle(autopilots, system)
    if vehicle is not None:
        return vehicle, "" if len(autopilots) == 1 else _announced(path, vehicle, autopilots)
    candidates = [sender for sender in frames if not autopilots and system in (None, sender[0])]
    if not candidates:
        present = ", ".join(str(number) for number in dict.fromkeys(number for number, _ in autopilots or frames))
        raise RequestError(
            f"{path}: no vehicle with system id {system} is in it. Choose (--system, or system= "
            f"in Python) one of: {present}; or leave it out."
        )
    vehicle = max(candidates, key=lambda sender: frames[sender])
    return vehicle, f"no autopilot's heartbeat: system {vehicle[0]}, which sends most, is taken for the vehicle"


def _announced(path: Path, vehicle: Address, autopilots: list[Address]) -> str:
    listed = ", ".join(f"{system}/{component}" for system, component in autopilots)
    how = "the first" if _choice.system is None else "which was chosen"
    text = f"{len(autopilots)} vehicles are on this link ({listed}); system {vehicle[0]}, {how}, is read"
    line = f"{path}: {text}"
    if _choice.announce is not None and line not in _choice.announced:
        _choice.announced.add(line)
        _choice.announce(line)
    return text
