"""What the verdict is made of: findings with their severity."""

from __future__ import annotations

from typing import Literal

import msgspec

Severity = Literal["error", "warning", "note"]


class Finding(msgspec.Struct, frozen=True):
    """Something a user should know. name: for programs. advice: what to do about it, empty when nothing."""

    severity: Severity
    name: str
    text: str
    advice: str = ""
