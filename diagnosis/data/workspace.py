"""Values that are computed once for their owner."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import Any, TypeVar

import msgspec

Value = TypeVar("Value")


class Workspace:
    """Values that were computed of one segment, model of sensors or judge: each holds its own, which ends with it.

    Keys are values (numbers, names, bytes of arrays, digests of segments), not objects: what is equal is found.
    """

    def __init__(self) -> None:
        self._values: dict[str, dict[Hashable, Any]] = {}

    def get(self, kind: str, key: Hashable, compute: Callable[[], Value], *, limit: int | None = None) -> Value:
        """The value of a key, computed where it is not there. limit: of the latest of its kind that are held."""
        values = self._values.setdefault(kind, {})
        if key not in values:
            computed = compute()
            if limit is not None and len(values) >= limit:
                del values[next(iter(values))]
            values[key] = computed
        value: Value = values[key]
        return value


def key_of(content: msgspec.Struct) -> bytes:
    """A vehicle or thresholds as a key: equal contents have one."""
    return msgspec.msgpack.encode(content, enc_hook=float)  # numbers of NumPy, which fits give
