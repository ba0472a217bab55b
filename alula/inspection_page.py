"""stub"""

from pathlib import Path

from flights.verdict import Inspection


def write_page(found: list[Inspection], path: Path) -> None:
    """x."""
