"""CasADi, imported when a formula is first written out: `from dynamics import symbolic as ca`.

Vehicles and effects are read, and bundles are flown, on computers without CasADi; models are built and compiled on
those that have it.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import util
from typing import Any

from dynamics.errors import RequestError
from dynamics.workbench_install import workbench_install


def __getattr__(name: str) -> Any:
    """CasADi's attribute of a name. Raises RequestError where CasADi is not installed."""
    if name.startswith("__"):
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    if not is_installed():
        raise RequestError(
            "building a model needs CasADi, which the flight computer's install leaves out. Run this on a workbench "
            f"({workbench_install()}); to fly here, `alula export` the model there and give `--bundle B`."
        )
    value = getattr(importlib.import_module("casadi"), name)
    globals()[name] = value
    return value


def is_installed() -> bool:
    """Whether models can be built here."""
    if "casadi" in sys.modules:
        return sys.modules["casadi"] not in (None, sys.modules[__name__])
    return util.find_spec("casadi") is not None


@contextmanager
def importable() -> Iterator[None]:
    """Lets a user's effect file `import casadi` where that is not installed: its formulas are then never called."""
    if is_installed():
        yield
        return
    before = sys.modules.get("casadi")
    sys.modules["casadi"] = sys.modules[__name__]
    try:
        yield
    finally:
        del sys.modules["casadi"]
        if before is not None:
            sys.modules["casadi"] = before
