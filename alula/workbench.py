"""Imports of the workbench's libraries, and the error on an install without them."""

from __future__ import annotations

import importlib
from collections.abc import Iterator
from contextlib import contextmanager

from alula.rooms import ROOMS
from dynamics.errors import RequestError
from dynamics.workbench_install import workbench_install


@contextmanager
def workbench(caller: str) -> Iterator[None]:
    """Import inside what `caller` needs of the workbench. Raises RequestError when it is not installed.

    The flight computer's install has no SciPy and no Arrow, and still has to start the command line.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        if error.name is not None and error.name.split(".")[0] in ("alula", *ROOMS):
            raise
        raise RequestError(
            f"{caller} needs {error.name}, which the flight computer's install leaves out: "
            f"{workbench_install()}, here or on a workbench."
        ) from error


def require_casadi(caller: str) -> None:
    """Raises RequestError where `caller` cannot build a model, because CasADi is not installed."""
    with workbench(caller):
        importlib.import_module("casadi")
