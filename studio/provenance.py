"""How a page came about: the command, the time, the files that were read."""

from __future__ import annotations

import datetime
import shlex
import sys
from collections.abc import Mapping
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from studio.page import Origin


def origin(inputs: Mapping[str, str], add: str = "") -> Origin:
    """The origin of a page made now by this command. inputs: sha256 by path. add: the command that adds an effect."""
    from studio.page import Origin  # jinja2 and plotly, which the flight computer has not

    made = datetime.datetime.now(tz=datetime.UTC).isoformat(timespec="seconds")
    return Origin(shlex.join(["alula", *sys.argv[1:]]), made, dict(inputs), add)
