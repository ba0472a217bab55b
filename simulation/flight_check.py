"""Flight check of a new bundle: whether the network itself flies a few seconds in lockstep on its own vehicle file.

`alula export` flies and writes the result into the bundle; `alula fly` reads it. Flying needs the readers of logs,
which a flight computer lacks, so that only flying imports them.
"""

from __future__ import annotations

from pathlib import Path

import msgspec

from dynamics.decoding import decode_json
from dynamics.errors import RequestError, VehicleError
from dynamics.files import write_whole
from dynamics.references import check_feasibility, named_reference
from dynamics.references.reference import Reference
from dynamics.vehicle import Vehicle
from runtime.control.bundle import Bundle, Manifest, read_bundle
from runtime.control.controller import Controller
from runtime.flight.events import Event

FILE = "flight_check.json"  # beside parity.json; not in the manifest, because it is no evidence about the files
MAX_AWAY = 0.1  # share of the time in which the nominal model may have flown in the network's place
GENTLE = ("Ellipse_1:laps=1", "hover:laps=1")  # 9 and 10 s; the first that the vehicle can fly
ADVICE = "Train with the physics-inspired loss on pulses and --input-noise 0.3, see docs/training.md."


class FlightCheck(msgspec.Struct, frozen=True):
    """A flight of a bundle on its own vehicle file, in lockstep with simulated sensors.

    seconds: of the reference that were flown.
    position_rmse: of ground truth, m; None where nothing was tracked.
    away: share of the time in which another model than the network flew.
    events: how often each was raised.
    ended: why the flight ended early, empty if it did not.
    """

    reference: str
    seconds: float = 0.0
    position_rmse: float | None = None
    away: float = 1.0
    events: dict[str, int] = {}
    ended: str = ""

    @property
    def held(self) -> bool:
        """Whether the network itself held the flight."""
        return not self.ended and self.away <= MAX_AWAY and Event.MODEL_OSCILLATES.value not in self.events

    @property
    def text(self) -> str:
        """One line for a terminal."""
        if self.ended:
            return f"{self.reference} in lockstep ended early: {self.ended}"
        error = "" if self.position_rmse is None else f" with {self.position_rmse:.3f} m RMS"
        events = ", ".join(name for name in self.events if name != Event.MODEL_WAITING.value)
        away = f"physics in the network's place {self.away:.0%} of them" + (f" ({events})" if events else "")
        return f"{self.seconds:.1f} s of {self.reference} in lockstep{error}, {away}"

    @property
    def warning(self) -> str:
        """The defect and what to do, empty where the network held the flight."""
        return "" if self.held else f"the network itself did not hold a simulated flight: {self.text}. {ADVICE}"

    @property
    def as_json(self) -> dict[str, object]:
        """The check for JSON, with verdict and warning."""
        return {**msgspec.structs.asdict(self), "held": self.held, "warning": self.warning}


def write_check(check: FlightCheck, folder: Path) -> None:
    """Write a check into a bundle. Raises RequestError when it cannot be written."""
    text = msgspec.json.format(msgspec.json.encode(check.as_json), indent=1) + b"\n"
    write_whole(folder / FILE, lambda path: path.write_bytes(text), advice="Free some space, or --no-flight-check.")


def read_check(folder: Path) -> FlightCheck | None:
    """The check in a bundle, None without one. Raises RequestError for a damaged file."""
    try:
        return decode_json((folder / FILE).read_bytes(), FlightCheck)
    except FileNotFoundError:
        return None
    except (OSError, msgspec.MsgspecError) as error:
        raise RequestError(f"{folder / FILE} cannot be read: {error}. Delete it, or export the model again.") from error


def check_bundle(folder: Path, manifest: Manifest) -> FlightCheck | None:
    """Fly a new bundle and write the check into it; None for bundles without a network, or for the workbench alone."""
    if not manifest.learned or manifest.filtered_inputs:
        return None
    check = check_flight(read_bundle(folder))
    write_check(check, folder)
    return check


def check_flight(bundle: Bundle) -> FlightCheck:
    """Fly a learned bundle, with the effects of its vehicle file and the noise of a vehicle's sensors."""
    from simulation.lockstep import fly_reference

    controller, nominal = Controller.from_bundle(bundle), Controller.fallback_from_bundle(bundle)
    reference = _gentle(controller.trim)
    try:
        flown = fly_reference(bundle.vehicle, reference, controller=controller, nominal=nominal)
    except VehicleError as error:
        return FlightCheck(reference.name, ended=str(error))
    seconds = flown.seconds
    return FlightCheck(
        reference.name,
        seconds,
        flown.position_rmse if seconds else None,
        flown.fallback_seconds / seconds if seconds else 1.0,
        dict(flown.events),
        flown.aborted,
    )


def _gentle(vehicle: Vehicle) -> Reference:
    references = [named_reference(name, vehicle) for name in GENTLE]
    return next((one for one in references if check_feasibility(one, vehicle).is_feasible), references[-1])
