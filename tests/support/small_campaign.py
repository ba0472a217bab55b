"""A campaign's folder of a few short flights, with what was true beside what was measured."""

from __future__ import annotations

import json
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from dynamics.references import named_reference
from dynamics.vehicle import Vehicle
from dynamics.vehicle_file import parse_effect
from fixtures.flight_store import stored
from flights import Flight
from simulation.lockstep import fly_reference


def fly_campaign(folder: Path, vehicle: Vehicle, effects: Sequence[str], flights: dict[str, str]) -> Path:
    """Write flights (split/name -> reference) that hide effects (text) from the vehicle's file."""
    (folder / "truth").mkdir(parents=True)
    (folder / "campaign.json").write_text(json.dumps({"effects": [*effects, "gust:intensity=0.1"]}))
    uses = [parse_effect(text, vehicle.rotors.count) for text in effects]
    for place, (name, text) in enumerate(flights.items()):
        reference = named_reference(text, vehicle)
        fly = partial(fly_reference, vehicle, reference, effects=uses, seed=place, name=name)
        flown = stored(fly, "small campaign", vehicle, text, uses, place, name)
        path = folder / f"{name}.parquet"
        path.parent.mkdir(exist_ok=True)
        Flight.from_log(flown.log, rate=100).to_parquet(path)
        Flight.from_log(flown.truth, rate=100).to_parquet(folder / "truth" / path.name)
    return folder
