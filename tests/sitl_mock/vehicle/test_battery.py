import casadi as ca
import pytest

from dynamics.vehicle import Vehicle
from sitl_mock.vehicle.battery import current_drawn, next_voltage, open_circuit_voltage, usual_battery


def test_a_cell_falls_from_full_to_empty() -> None:
    voltages = [float(open_circuit_voltage(charge / 10)) for charge in range(10, -1, -1)]
    assert voltages == sorted(voltages, reverse=True)
    assert voltages[0] == pytest.approx(4.2, abs=0.001)
    assert voltages[-1] == pytest.approx(3.3)


def test_hover_current_empties_the_battery_in_its_endurance(arpl_250g: Vehicle) -> None:
    battery = usual_battery(arpl_250g, endurance=600.0)
    speed = [arpl_250g.hover_speed] * 4
    current = float(current_drawn(ca.DM(speed), arpl_250g.rotors.torque_constant, 3.8 * battery.cells))
    assert battery.capacity / current == pytest.approx(600.0)


def test_a_load_lowers_the_voltage_by_the_internal_resistance() -> None:
    values = {"cells": 3, "resistance": 0.05}
    assert float(next_voltage(0.8, 0.0, values)) - float(next_voltage(0.8, 10.0, values)) == pytest.approx(0.5)
