"""Errors of two versions of a vehicle, as several commands print them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

from rich.table import Table

if TYPE_CHECKING:
    from diagnosis.models.open_loop import HorizonError
    from diagnosis.report import ChannelError

QUANTITIES = ("position m", "velocity m/s", "attitude rad", "rate rad/s")


def before_and_after(channels: Mapping[str, ChannelError], where: str = "held out") -> Iterator[str]:
    """A line for each kind of channel with its errors and its floor. where: on which flights."""
    from diagnosis.models.channels import NAMES

    for kind, error in channels.items():
        change = f"{100 * (error.after / error.before - 1):+.1f} %"
        yield (
            f"{NAMES[kind]}, {where}: {error.before:.4g} -> {error.after:.4g} {error.unit} ({change}), "
            f"floor {error.floor:.4g}"
        )


def open_loop_table(before: Sequence[HorizonError], after: Sequence[HorizonError]) -> Table:
    """Prediction errors of both, by horizon."""
    table = Table("open loop, s", "model", title="prediction error on held-out flights", title_justify="left")
    for heading in QUANTITIES:
        table.add_column(heading, justify="right")
    for pair in zip(before, after, strict=True):
        for which, error in zip(("before", "after"), pair, strict=True):
            table.add_row(f"{error.horizon:g}", which, *error.figures)
    return table
