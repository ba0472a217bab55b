"""Findings with their severity, of which the verdict is made."""

from __future__ import annotations

from typing import Literal

import msgspec

FindingSeverity = Literal["error", "warning", "note"]


class Finding(msgspec.Struct, frozen=True):
    """One defect or remark about a log.

    name: for programs.
    text: for people.
    advice: what to do, empty when nothing.
    fatal: whether the log identifies nothing because of it.
    """

    severity: FindingSeverity
    name: str
    text: str
    advice: str = ""
    fatal: bool = False
