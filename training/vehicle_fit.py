"""Whether a vehicle file is that of the vehicle that flew: its textbook model against the flights' labels."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dynamics.arrays import Floats
from dynamics.errors import DataError
from dynamics.vehicle import Vehicle

FEWEST = 100  # rows of a flight that can be judged
MAX_OFF = 2.5  # factor of specific force, or of roll and pitch, by which a vehicle file may err and not be another's
MIN_AGREEMENT = 0.2  # correlation of modelled with measured roll and pitch acceleration over all flights
MAX_OPPOSITION = -0.2  # and of one flight, which may be slow, or all drag: it must not turn the other way
EXCITED = 0.5  # rad/s^2 of angular acceleration from which on that can be judged


def require_fit(vehicle: Vehicle, flights: Sequence[tuple[str, Floats, Floats]]) -> None:
    """Refuse a vehicle file whose textbook model has nothing to do with the flights. Raises DataError.

    flights: name, (n, 6) body accelerations that the flight shows, and those that the model says. The size of roll and
    pitch, and that they agree at all, is asked of all flights together: missing effects can hide it in one of them.
    """
    for name, label, nominal in flights:
        if len(label) >= FEWEST:
            misfit = f"the vehicle file {vehicle.name} does not fit {name}"
            _require_force(misfit, label, nominal)
            _require_agreement(misfit, label, nominal, roll_and_pitch=MAX_OPPOSITION)
    label, nominal = (np.concatenate([flight[place] for flight in flights]) for place in (1, 2))
    misfit = f"the vehicle file {vehicle.name} does not fit these flights"
    _require_turning(misfit, label, nominal)
    _require_agreement(misfit, label, nominal, roll_and_pitch=MIN_AGREEMENT)


def _require_force(misfit: str, label: Floats, nominal: Floats) -> None:
    ratio = float(np.sum(label[:, 2] * nominal[:, 2]) / np.sum(nominal[:, 2] ** 2))
    if not 1 / MAX_OFF < ratio < MAX_OFF:
        raise DataError(
            f"{misfit}, which shows {ratio:.2f} times the specific force that its rotors give. Check mass, "
            "thrust_constant (N s^2/rad^2) and speed_max (rad/s), or give the file of the vehicle that flew."
        )


def _require_turning(misfit: str, label: Floats, nominal: Floats) -> None:
    shown, said = label[:, 3:5].std(axis=0), nominal[:, 3:5].std(axis=0)
    if np.any(shown < EXCITED) or np.any(said == 0):
        return
    turning = shown / said
    if np.all(turning > MAX_OFF) or np.all(turning < 1 / MAX_OFF):
        raise DataError(
            f"{misfit}, where roll and pitch accelerate {turning[0]:.2g} and {turning[1]:.2g} times as much as it "
            "says. Check inertia (kg m^2) and rotor positions (m), or give the file of the vehicle that flew."
        )


def _require_agreement(misfit: str, label: Floats, nominal: Floats, *, roll_and_pitch: float) -> None:
    """Yaw must not turn the other way: its torques are too weak to ask for more."""
    for axis, name, least, check in (
        (3, "roll", roll_and_pitch, "the order and the positions"),
        (4, "pitch", roll_and_pitch, "the order and the positions"),
        (5, "yaw", MAX_OPPOSITION, "the order and the spin"),
    ):
        shown, said = label[:, axis], nominal[:, axis]
        if said.std() == 0 or shown.std() < (EXCITED if axis < 5 else 1e-9):
            continue
        agreement = float(np.corrcoef(shown, said)[0, 1])
        if agreement < least:
            raise DataError(
                f"{misfit}: its {name} acceleration correlates with what was flown by {agreement:.2f}. Check {check} "
                "of its rotors, or leave out flights of another vehicle."
            )
