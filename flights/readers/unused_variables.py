"""Log variables of a Crazyflie that are not read as a flight's quantity, and what they may be."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import numpy as np

from dynamics.arrays import Floats
from flights.assembly import Assembly
from flights.quantities import PRIMARY
from flights.readers.unused_groups import groups_of, keep_groups

MAX_VARIABLES = 128
_ROWS = 20_000  # of a variable that are judged
_MIN_OF_GROUP = 2
# Groups that are understood and not used, by the start of their variables' names.
_REASONS: Mapping[str, str] = {"stateEstimateZ.a": "firmwares differ in whether gravity is in it"}

Streams = Sequence[tuple[str, tuple[str, ...]]]  # quantity, and its variables in the order of its columns


def variables_to_read(names: Sequence[str], used: Collection[str]) -> list[str]:
    """Variables that stand in a group, so that they may be a quantity. names: of all. used: those that are read."""
    others = [name for name in dict.fromkeys(names) if name and name not in used]
    grouped = {others[index] for group in groups_of(others) for index in group.fields}
    return [name for name in others if name in grouped][:MAX_VARIABLES]


def keep_variables(assembly: Assembly, columns: Mapping[str, Floats], used: Collection[str], streams: Streams) -> None:
    """Keep as unused the variables that may be a flight's quantity. columns: (n,) each by its group.name."""
    rows = max((len(column) for column in columns.values()), default=0)
    step = max(1, rows // _ROWS)
    thinned = {name: column[::step] for name, column in columns.items() if name not in used}
    for quantity, variables in streams:
        present = [name for name in variables if name in thinned]
        missing = [name for name in variables if name not in columns]
        if quantity in PRIMARY and missing and len(present) >= _MIN_OF_GROUP:
            belongs = "which belongs to them, is" if len(missing) == 1 else "which belong to them, are"
            table = np.stack([thinned.pop(name) for name in present], axis=1)
            reason = f"{' and '.join(missing)}, {belongs} not logged"
            assembly.leave_out(quantity, _parent(present[0]), present, table, reason, count=rows)
    by_parent: dict[str, list[str]] = {}
    for name in thinned:
        by_parent.setdefault(_parent(name), []).append(name)
    for parent, names in by_parent.items():
        for reason in dict.fromkeys(map(_reason, names)):
            part = [name for name in names if _reason(name) == reason]
            table = np.stack([thinned[name] for name in part], axis=1)
            keep_groups(assembly, parent, part, table, words=(parent,), reason=reason, count=rows)


def _parent(name: str) -> str:
    return name.rpartition(".")[0] or "table"


def _reason(name: str) -> str:
    return next((reason for start, reason in _REASONS.items() if name.startswith(start)), "")
