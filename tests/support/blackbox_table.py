"""Decoded blackbox logs of a truth, in the numbers of Betaflight, INAV and Rotorflight."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from dynamics import quaternion
from dynamics.arrays import Floats
from dynamics.vehicle import GRAVITY
from tests.support.flight_files import Truth

FLU, FRD = (1.0, 1.0, 1.0), (1.0, -1.0, -1.0)
MOTORS = (2, 3, 1, 0)  # our rotor of Betaflight's motors 1 to 4
FULL_SPEED = 2000.0  # rad/s at full command


def columns_of(
    truth: Truth,
    *,
    gyro: tuple[float, float, float] = FLU,
    with_attitude: bool = True,
    with_erpm: bool = True,
    one_g: float = 2048.0,
    poles: int = 14,
    motors: tuple[float, float] = (48.0, 2047.0),
) -> dict[str, Floats]:
    """Betaflight's columns. gyro: signs of its axes against x forward, y left, z up."""
    upright = truth.attitude * np.sign(truth.attitude[:, :1])
    speed = truth.rotor_speed[:, list(MOTORS)]
    table: dict[str, Floats] = {"loopIteration": 8.0 * np.arange(len(truth.time)), "time (us)": 9e7 + truth.time * 1e6}
    table |= _array("gyroADC", np.degrees(truth.rate) * np.array(gyro))
    table |= _array("accSmooth", truth.specific_force / GRAVITY * one_g)
    if with_attitude:
        table |= _array("imuQuaternion", upright[:, 1:] * 32767)
    table |= _array("motor", motors[0] + (motors[1] - motors[0]) * speed / FULL_SPEED)
    if with_erpm:
        table |= _array("eRPM", speed * 60 / (2 * np.pi) * poles / 2 / 100)
    return {name: values if name == "time (us)" else np.rint(values) for name, values in table.items()}


def inav_columns(truth: Truth) -> dict[str, Floats]:
    """INAV's columns: angles in tenths of a degree, position in centimetres north, east and up."""
    table = columns_of(truth, with_attitude=False, with_erpm=False, one_g=512.0, motors=(1000.0, 2000.0))
    roll, pitch, yaw = quaternion.to_euler(truth.attitude).T
    heading = np.mod(90.0 - np.degrees(yaw), 360.0)
    table |= _array("attitude", np.rint(np.column_stack([10 * np.degrees(roll), 10 * np.degrees(pitch), 10 * heading])))
    table |= _array("navPos", np.rint(100 * truth.position[:, [1, 0, 2]]))
    return table | _array("navVel", np.rint(100 * truth.velocity[:, [1, 0, 2]]))


def _array(name: str, values: Floats) -> dict[str, Floats]:
    return {f"{name}[{index}]": column for index, column in enumerate(values.T)}


def text_of(columns: Mapping[str, Floats], *, preamble: str = "", quoted: bool = False) -> str:
    """The table as blackbox_decode prints it, with flags as words; quoted: as the blackbox explorer does."""
    names = [f'"{name}"' if quoted else name for name in columns]
    rows = [
        ", ".join(f"{value:.0f}" for value in row) + ", ARM|ACRO" for row in np.column_stack(list(columns.values()))
    ]
    return preamble + "\n".join([", ".join([*names, "flightModeFlags (flags)"]), *rows]) + "\n"
