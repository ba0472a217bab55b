"""A problem that a check has found."""

from __future__ import annotations

from typing import Literal

import msgspec


class Problem(msgspec.Struct, frozen=True):
    """A problem that a check has found. An error refuses a flight; a warning should be understood before one."""

    severity: Literal["error", "warning"]
    text: str
