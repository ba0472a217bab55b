"""Numbers, units and quantities as pages write them."""

from __future__ import annotations

import math

SIGNS = str.maketrans("0123456789-", "⁰¹²³⁴⁵⁶⁷⁸⁹⁻")
UNITS = {"m/s^2": "m/s²", "rad/s^2": "rad/s²", "1": ""}


def shown(value: float | None, digits: int = 3) -> str:
    """A number with the given count of significant digits: 0.0123, 12.3, 1,230, 2.20 × 10⁻⁵; a dash for none."""
    if value is None or not math.isfinite(value):
        return "–"
    if value == 0:
        return "0"
    mantissa, power = f"{value:.{digits - 1}e}".split("e")
    exponent = int(power)
    if exponent < -3 or exponent > 6:
        return f"{mantissa} × 10{str(exponent).translate(SIGNS)}"
    return f"{value:,.{max(0, digits - 1 - exponent)}f}"


def unit_shown(unit: str) -> str:
    """A unit as people write it: m/s² for m/s^2, nothing for 1."""
    return UNITS.get(unit, unit.replace("^2", "²").replace("^3", "³").replace(" ", " "))


def quantity_shown(name: str) -> str:
    """A quantity whose name ends with its unit as axes are titled: "speed, m/s" for "speed m/s"."""
    quantity, _, unit = name.rpartition(" ")
    return f"{quantity}, {unit}" if unit in ("m", "m/s", "rad", "rad/s", "s") else name
