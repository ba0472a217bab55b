"""The head of a step's page: its title, and what stands in its way."""

from __future__ import annotations

from typing import Any

import dash_mantine_components as dmc

from studio.app.opened import OpenCase
from studio.app.parts import message


def head(opened: OpenCase, title: str) -> list[Any]:
    """The title, and the fault in which the last step ended, if it did."""
    parts: list[Any] = [dmc.Title(title, order=1, size="h2")]
    if opened.failure:
        parts.append(message(opened.failure, title="The last step failed", colour="red"))
    return parts


def lock(opened: OpenCase, step: str) -> list[Any]:
    """Why a step cannot be worked on yet; empty where it can."""
    reason = opened.lock_reason(step)
    return [message(reason, title="Locked")] if reason else []


def refusal(opened: OpenCase, step: str, title: str, *, colour: str = "yellow") -> list[Any]:
    """Why a step was refused for the present state; empty where it was not."""
    refused = opened.refusal(step)
    return [] if refused is None else [message(refused.message, title=title, colour=colour)]
