"""Commands of the desk on an install that has none of its libraries."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from dynamics.errors import RequestError

ROOMS = (
    "alula", "diagnosis", "dynamics", "export", "flights", "runtime", "simulation", "sitl_mock", "studies", "studio",
    "training", "vehicles",
)  # fmt: skip


@contextmanager
def workbench(command: str) -> Iterator[None]:
    """Import what a command of the desk needs inside. Raises RequestError when it is not installed.

    The flight computer's install has no SciPy and no Arrow, and still has to start the command line.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        if error.name is not None and error.name.split(".")[0] in ROOMS:
            raise
        raise RequestError(
            f"{command} needs {error.name}, which the flight computer's install leaves out. Install alula[workbench]."
        ) from error
