"""One flight of a fleet: the line that is written of it."""

from __future__ import annotations

from typing import Literal

import msgspec

Status = Literal["diagnosed", "refused", "failed"]
DateSource = Literal["log", "name", "file", ""]


class FleetParameter(msgspec.Struct, frozen=True):
    """A fitted parameter with its standard deviation and 95 % interval; a held one has no width."""

    value: float
    std: float
    low: float
    high: float
    unit: str


class FleetEffect(msgspec.Struct, frozen=True):
    """An effect that a flight shows to be missing, with the fields of `alula diagnose --json`."""

    name: str
    rotor: int | None
    parameters: dict[str, FleetParameter]
    confidence: float
    ambiguous_with: tuple[str, ...] = ()

    @property
    def key(self) -> str:
        """The name, and the rotor in brackets where there is one."""
        return self.name if self.rotor is None else f"{self.name}[{self.rotor}]"


class FleetChannel(msgspec.Struct, frozen=True):
    """RMS on the held-out seconds with the present and with the improved model, and the noise floor.

    over_floor: of the present model; null where there is no floor.
    """

    before: float
    after: float
    floor: float
    over_floor: float | None
    unit: str


class FleetFlight(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A log and its diagnosis, or why there is none.

    log: its path in the folder.
    status: "refused" where log or vehicle cannot be used, which another run would repeat; "failed" where something
        else went wrong (a file that could not be opened, a process that was killed): the next run tries again.
    sha256: of the log; empty where it could not be read.
    size, modified: of the file, bytes and ns.
    settings: hash of the vehicle file, the options and the version of Alula behind the result.
    vehicle, vehicle_file: its name and where it was found, empty without one.
    airframe: identity that the autopilot writes into its log, empty without one.
    date, date_from: ISO 8601, and whether the log, its name or the file's time of change gives it.
    duration, free_flight: s.
    inspection, inspected: the inspection's verdict and sentence; empty for a log that could not be read.
    verdict, sentence: of the diagnosis; empty without one.
    next_flight: what to fly next.
    seconds: that the work took.
    worker: machine and process.
    error: why there is no diagnosis.
    """

    log: str
    status: Status
    sha256: str = ""
    size: int = 0
    modified: int = 0
    settings: str = ""
    vehicle: str = ""
    vehicle_file: str = ""
    airframe: str = ""
    date: str = ""
    date_from: DateSource = ""
    duration: float = 0.0
    free_flight: float = 0.0
    inspection: str = ""
    inspected: str = ""
    verdict: str = ""
    sentence: str = ""
    effects: tuple[FleetEffect, ...] = ()
    channels: dict[str, FleetChannel] = {}
    next_flight: str = ""
    seconds: float = 0.0
    worker: str = ""
    error: str = ""

    @property
    def is_dated(self) -> bool:
        """Whether the date is that of the flight; a file's time of change may be that of a copy."""
        return self.date_from in ("log", "name")

    @property
    def owner(self) -> tuple[str, str, str]:
        """Whose history the flight belongs to: the vehicle, its file and its airframe."""
        return self.vehicle, self.vehicle_file, self.airframe
