"""Origin of a page made now: the command, the time, the files that were read."""

from __future__ import annotations

import datetime
from collections.abc import Collection, Mapping
from typing import TYPE_CHECKING

from dynamics.command import command_line

if TYPE_CHECKING:
    from diagnosis.data.dataset import Dataset
    from studio.pages.page import Origin


def origin(inputs: Mapping[str, str], add: str = "", *, held_out: Collection[str] = ()) -> Origin:
    """The origin of a page made now by this command.

    inputs: sha256 by path. add: the command that adds an effect. held_out: inputs that nothing was fitted to.
    """
    from studio.pages.page import Origin  # imports jinja2 and plotly, which the base install lacks

    made = datetime.datetime.now(tz=datetime.UTC).isoformat(timespec="seconds")
    return Origin(command_line(), made, dict(inputs), add, held_out)


def dataset_origin(dataset: Dataset, add: str = "") -> Origin:
    """The origin of a page on a diagnosis' flights. add: as for `origin`."""
    return origin({**dataset.hashes, **dataset.held_hashes}, add, held_out=tuple(dataset.held_hashes))
