"""A lithium-polymer battery: its voltage falls with the charge used and with the current drawn."""

from __future__ import annotations

import msgspec

from dynamics import symbolic as ca
from dynamics.effect import Expression, Values
from dynamics.errors import RequestError
from dynamics.vehicle import Vehicle

FULL_CELL = 4.2  # V
AVIONICS_POWER = 3.0  # W
POWER_TRAIN_EFFICIENCY = 0.7


class BatteryPack(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A battery pack.

    cells: in series.
    capacity: A s.
    resistance: internal, ohm.
    charge: at the start, 0..1.
    """

    cells: int
    capacity: float
    resistance: float
    charge: float = 1.0

    def __post_init__(self) -> None:
        possible = self.cells >= 1 and self.capacity > 0 and self.resistance >= 0 and 0 < self.charge <= 1
        if not possible:
            raise RequestError(
                f"battery of {self.cells} cells, {self.capacity} A s, {self.resistance} ohm, charge {self.charge}: "
                "wanted at least one cell, a positive capacity, a resistance of 0 or more and a charge in (0, 1]."
            )

    @property
    def nominal_voltage(self) -> float:
        """Voltage of the full battery at rest, V: the one that the vehicle file's constants hold at."""
        return self.cells * FULL_CELL


def usual_battery(vehicle: Vehicle, *, endurance: float = 900.0, charge: float = 1.0) -> BatteryPack:
    """A battery that hovers the vehicle for so many seconds and sags by 4 % under the hover current."""
    cells = 2 if vehicle.body.mass < 0.15 else 3 if vehicle.body.mass < 0.4 else 4
    power = vehicle.rotors.count * vehicle.rotors.torque_constant * vehicle.hover_speed**3 / POWER_TRAIN_EFFICIENCY
    current = (power + AVIONICS_POWER) / (cells * 3.8)
    return BatteryPack(cells, current * endurance, 0.04 * cells * FULL_CELL / current, charge)


def open_circuit_voltage(charge: Expression) -> Expression:
    """Voltage of a resting cell for a charge of 0..1, V: 4.2 when full, 3.6 near empty, 3.3 when empty."""
    return 3.6 + 0.6 * charge - 0.3 * ca.exp(-20 * charge)


def current_drawn(rotor_speed: Expression, torque_constant: Expression, voltage: Expression) -> Expression:
    """Current for the rotors' shaft power k_tau Omega^3 through the power train, and for the avionics, A."""
    power = torque_constant * ca.sum1(ca.fabs(rotor_speed) ** 3) / POWER_TRAIN_EFFICIENCY
    return (power + AVIONICS_POWER) / ca.fmax(voltage, 1.0)


def next_voltage(charge: Expression, current: Expression, battery: Values) -> Expression:
    """Voltage at the terminals, V. battery: cells, resistance."""
    resting = battery["cells"] * open_circuit_voltage(ca.fmax(charge, 0))
    return ca.fmax(resting - battery["resistance"] * current, 0.3 * resting)
