"""Origin of a page made now: the command, the time, the files that were read."""

from __future__ import annotations

import datetime
from collections.abc import Mapping
from typing import TYPE_CHECKING

from dynamics.command import command_line

if TYPE_CHECKING:
    from studio.page import Origin


def origin(inputs: Mapping[str, str], add: str = "") -> Origin:
    """The origin of a page made now by this command. inputs: sha256 by path. add: the command that adds an effect."""
    from studio.page import Origin  # imports jinja2 and plotly, which the base install lacks

    made = datetime.datetime.now(tz=datetime.UTC).isoformat(timespec="seconds")
    return Origin(command_line(), made, dict(inputs), add)
