"""Two versions of a vehicle file on flights that nothing was fitted to, as `alula prove --json` writes them."""

from __future__ import annotations

from collections.abc import Mapping

import msgspec

from diagnosis.addition import horizons_of
from diagnosis.addition_report import OpenLoop
from diagnosis.by_likelihood import noise_of
from diagnosis.data.dataset import Dataset
from diagnosis.estimation.held_out import HeldOut
from diagnosis.one_thread import one_thread
from diagnosis.report import ChannelError
from diagnosis.verdict import channel_errors
from dynamics.effect import Effect
from dynamics.errors import RequestError
from dynamics.progress import Progress, no_progress
from dynamics.vehicle import Vehicle


class Proof(msgspec.Struct, frozen=True):
    """Held-out errors of two versions of a vehicle.

    effects: of the second version, by their names, the rotor in brackets.
    held_out: the flights.
    channels: RMS of both and floor, by kind of channel.
    open_loop: prediction errors of both; empty where the logs hold no pose.
    """

    effects: tuple[str, ...]
    held_out: tuple[str, ...]
    channels: dict[str, ChannelError]
    open_loop: OpenLoop


@one_thread
def prove_versions(
    dataset: Dataset,
    first: Vehicle,
    present: Vehicle,
    catalogue: Mapping[str, Effect],
    progress: Progress = no_progress,
) -> Proof:
    """Errors of both versions on the held-out flights, one step and in open loop.

    Raises RequestError for versions with different numbers of rotors, DataError for flights that cannot answer.
    """
    counts = [vehicle.rotors.count for vehicle in (first, present)]
    if counts[0] != counts[1]:
        advice = "Give two versions of one vehicle's file."
        raise RequestError(f"{first.name} has {counts[0]} rotors and {present.name} has {counts[1]}. {advice}")
    progress(0.1, "noise of the flights")
    judge = HeldOut(noise_of(dataset, first, catalogue), dataset.held_out)
    progress(0.6, "predictions of both versions")
    floor, sensors = judge.floor(present), judge.sensors(present)
    return Proof(
        effects=tuple(use.label for use in present.effects),
        held_out=tuple(dict.fromkeys(segment.flight for segment in dataset.held_out)),
        channels=channel_errors(judge.rows(first), judge.rows(present), floor, sensors),
        open_loop=OpenLoop(horizons_of(judge, first), horizons_of(judge, present)),
    )
