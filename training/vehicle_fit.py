"""Whether a vehicle file is that of the vehicle that flew: its nominal model against the flights' labels."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dynamics.arrays import Floats
from dynamics.errors import DataError
from dynamics.vehicle import Vehicle

MIN_ROWS = 100  # rows of a flight that can be tested
MAX_FACTOR = 2.5  # factor by which a vehicle file's specific force, or its roll and pitch accelerations, may err
MIN_AGREEMENT = 0.2  # correlation of modelled with measured roll and pitch acceleration over all flights
MIN_AGREEMENT_OF_ONE = -0.2  # for one flight, slow or dominated by drag: not the opposite direction
MIN_EXCITATION = 0.5  # rad/s^2 of angular acceleration from which on that can be tested


def require_fit(vehicle: Vehicle, flights: Sequence[tuple[str, Floats, Floats]]) -> None:
    """Refuse a vehicle file whose nominal model does not resemble the flights. Raises DataError.

    flights: name, (n, 6) measured body accelerations, (n, 6) those of the model. The size of roll and pitch
    accelerations and their correlation are tested over all flights together: missing effects can hide it in one.
    """
    for name, label, nominal in flights:
        if len(label) >= MIN_ROWS:
            head = f"the vehicle file {vehicle.name} does not fit {name}"
            _require_force(head, label, nominal)
            _require_agreement(head, label, nominal, roll_and_pitch=MIN_AGREEMENT_OF_ONE)
    label, nominal = (np.concatenate([flight[place] for flight in flights]) for place in (1, 2))
    head = f"the vehicle file {vehicle.name} does not fit these flights"
    _require_turning(head, label, nominal)
    _require_agreement(head, label, nominal, roll_and_pitch=MIN_AGREEMENT)


def _require_force(head: str, label: Floats, nominal: Floats) -> None:
    ratio = float(np.sum(label[:, 2] * nominal[:, 2]) / np.sum(nominal[:, 2] ** 2))
    if not 1 / MAX_FACTOR < ratio < MAX_FACTOR:
        raise DataError(
            f"{head}, which shows {ratio:.2f} times the specific force of its rotors. Check mass, "
            "thrust_constant (N s^2/rad^2) and speed_max (rad/s), or give the file of the vehicle that flew."
        )


def _require_turning(head: str, label: Floats, nominal: Floats) -> None:
    measured, modelled = label[:, 3:5].std(axis=0), nominal[:, 3:5].std(axis=0)
    if np.any(measured < MIN_EXCITATION) or np.any(modelled == 0):
        return
    turning = measured / modelled
    if np.all(turning > MAX_FACTOR) or np.all(turning < 1 / MAX_FACTOR):
        raise DataError(
            f"{head}, where roll and pitch accelerate {turning[0]:.2g} and {turning[1]:.2g} times as much as "
            "modelled. Check inertia (kg m^2) and rotor positions (m), or give the file of the vehicle that flew."
        )


def _require_agreement(head: str, label: Floats, nominal: Floats, *, roll_and_pitch: float) -> None:
    """Yaw torques are weak, so that a yaw acceleration is refused only if it has the opposite direction."""
    for axis, name, bound, check in (
        (3, "roll", roll_and_pitch, "the order and the positions"),
        (4, "pitch", roll_and_pitch, "the order and the positions"),
        (5, "yaw", MIN_AGREEMENT_OF_ONE, "the order and the spin"),
    ):
        measured, modelled = label[:, axis], nominal[:, axis]
        if modelled.std() == 0 or measured.std() < (MIN_EXCITATION if axis < 5 else 1e-9):
            continue
        agreement = float(np.corrcoef(measured, modelled)[0, 1])
        if agreement < bound:
            raise DataError(
                f"{head}: its {name} acceleration correlates with what was flown by {agreement:.2f}. Check {check} "
                "of its rotors, or leave out flights of another vehicle."
            )
