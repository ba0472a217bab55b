"""Betaflight blackbox logs: recognised, and refused with the tool that converts them.

No maintained parser can be installed (pip refuses orangebox 0.5), and the format's predictors are
too many for one of our own.
"""

from __future__ import annotations

from dynamics.errors import DataError
from flights.log import LogContent
from flights.source import Source


def matches(source: Source) -> bool:
    """Whether it begins with the header that every blackbox log has."""
    return source.head.startswith(b"H Product:Blackbox")


def read(source: Source) -> LogContent:
    """Raises DataError, which names the converter to CSV."""
    raise DataError(
        "this is a Betaflight blackbox log, which is not read directly. Convert it with blackbox_decode of "
        "blackbox-tools (--unit-rotation rad/s --unit-acceleration m/s2) and give its CSV with a column-mapping TOML."
    )
