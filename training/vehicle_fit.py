"""Whether a vehicle file is that of the vehicle that flew: its textbook model against a flight's labels."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dynamics.errors import DataError
from dynamics.vehicle import Vehicle

Floats = NDArray[np.float64]
FEWEST = 100  # rows of a flight that can be judged
MOST_OFF = 2.5  # factor of specific force, or of roll and pitch, by which a vehicle file may err and not be another's
LEAST_AGREEMENT = 0.2  # correlation of modelled with measured roll and pitch acceleration
MOST_OPPOSITION = -0.2  # of yaw, whose torques are too weak to ask for more than that they do not turn the other way
EXCITED = 0.5  # rad/s^2 of angular acceleration from which on that can be judged


def require_fit(vehicle: Vehicle, flight: str, label: Floats, nominal: Floats) -> None:
    """Refuse a vehicle file whose textbook model has nothing to do with a flight. Raises DataError.

    label, nominal: (n, 6) body accelerations that the flight shows and that the model says.
    """
    if len(label) < FEWEST:
        return
    misfit = f"the vehicle file {vehicle.name} does not fit {flight}"
    ratio = float(np.sum(label[:, 2] * nominal[:, 2]) / np.sum(nominal[:, 2] ** 2))
    if not 1 / MOST_OFF < ratio < MOST_OFF:
        raise DataError(
            f"{misfit}, which shows {ratio:.2f} times the specific force that its rotors give. Check mass, "
            "thrust_constant (N s^2/rad^2) and speed_max (rad/s), or give the file of the vehicle that flew."
        )
    if np.all(label[:, 3:5].std(axis=0) >= EXCITED) and np.all(nominal[:, 3:5].std(axis=0) > 0):
        _require_roll_and_pitch(misfit, label, nominal)
    agreement = _correlation(label[:, 5], nominal[:, 5])
    if agreement < MOST_OPPOSITION:
        raise DataError(
            f"{misfit}: its yaw acceleration correlates with the flight's by {agreement:.2f}. Check the order and the "
            "spin of its rotors, or leave the flight out."
        )


def _require_roll_and_pitch(misfit: str, label: Floats, nominal: Floats) -> None:
    turning = label[:, 3:5].std(axis=0) / nominal[:, 3:5].std(axis=0)
    if np.all(turning > MOST_OFF) or np.all(turning < 1 / MOST_OFF):
        raise DataError(
            f"{misfit}, where roll and pitch accelerate {turning[0]:.2g} and {turning[1]:.2g} times as much as it "
            "says. Check inertia (kg m^2) and rotor positions (m), or give the file of the vehicle that flew."
        )
    for axis, name in ((3, "roll"), (4, "pitch")):
        agreement = _correlation(label[:, axis], nominal[:, axis])
        if agreement < LEAST_AGREEMENT:
            raise DataError(
                f"{misfit}: its {name} acceleration correlates with the flight's by {agreement:.2f}. Check the order "
                "and the positions of its rotors, or leave the flight out."
            )


def _correlation(one: Floats, other: Floats) -> float:
    """Of (n,) values, 0 where one of them stands still."""
    if one.std() == 0 or other.std() == 0:
        return 0.0
    return float(np.corrcoef(one, other)[0, 1])
