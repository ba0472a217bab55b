"""How the models beside the vehicle files err on the campaign's test flights: against labels and against the truth.

Needs `alula campaign --out build/campaign_learning`.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import msgspec
import torch
from provenance import write_result

from dynamics.vehicle import Vehicle
from dynamics.vehicle_file import parse_effect, read_vehicle
from training import checkpoint
from training.card import FlightError
from training.checkpoint import TrainedModel
from training.dataset import Dataset, make_dataset
from training.models import named_kind
from training.prediction import flight_errors, pooled, predict
from training.recordings import Recording, find_logs, read_recordings
from training.truth import true_label
from vehicles import FOLDER

CAMPAIGN = Path(__file__).parents[1] / "build" / "campaign_learning"
FLOOR_RATIO = 1.03  # of the grey box's own error, which no flight may exceed


def errors_of(
    model: TrainedModel, data: Dataset, *, gated: bool = True
) -> tuple[tuple[FlightError, ...], tuple[FlightError, ...]]:
    """Errors on every flight against labels and against the truth."""
    body = predict(model, data, gated=gated).body
    return flight_errors(data, body), flight_errors(data, body, true_label(data, CAMPAIGN, dt=model.config.dt))


def row(name: str, trained: str, lab: tuple[FlightError, ...], true: tuple[FlightError, ...]) -> str:
    """Linear, angular and all components, all test flights as one."""
    cells = [f"{e.linear:.3f} / {e.angular:.3f} / {e.combined:.3f}" for e in (pooled(lab), pooled(true))]
    ratio, base = pooled(true).combined / pooled(true).nominal, pooled(true).base
    over = "" if base is None else f"{pooled(true).combined / base:.3f}"
    return f"| {name} | {trained} | {cells[0]} | {cells[1]} | {ratio:.3f} | {over} |"


def with_the_campaigns_effects(vehicle: Vehicle) -> Vehicle:
    """The vehicle with all that the campaign hides; gusts and what the autopilot does within 10 ms are not in it."""
    hidden = msgspec.json.decode((CAMPAIGN / "campaign.json").read_bytes())["effects"]
    return vehicle.with_effects(*[parse_effect(text, vehicle.rotors.count) for text in hidden])


def of_base(name: str, vehicle: Vehicle, recordings: Sequence[Recording]) -> str:
    """A row for a vehicle's own model, with the effects that it names."""
    config = msgspec.structs.replace(named_kind("nominal").config, base="grey_box", history=20)
    data = make_dataset(config, vehicle, recordings)
    assert data.base is not None
    body = data.base[data.ends]
    lab, true = flight_errors(data, body), flight_errors(data, body, true_label(data, CAMPAIGN, dt=config.dt))
    return row(name, "", lab, true)


def main() -> None:
    """Write results/trained_models.md."""
    torch.set_num_threads(1)
    if not (CAMPAIGN / "manifest.json").exists():
        sys.exit(f"{CAMPAIGN} is missing: alula campaign --out build/campaign_learning")
    recordings = read_recordings(find_logs([CAMPAIGN / "test"]), dt=0.01, may_be_tests=True)
    plain = read_vehicle(FOLDER / "arpl_250g.toml")
    rows = [
        of_base("textbook model", plain, recordings),
        of_base("the campaign's own effects", with_the_campaigns_effects(plain), recordings),
    ]
    flights = {}
    for path in sorted(FOLDER.glob("*.pt")):
        model = checkpoint.load(path)
        data = make_dataset(model.config, model.vehicle, recordings)
        lab, true = errors_of(model, data)
        steps, seconds = "/".join(map(str, model.card.steps[:1])), sum(model.card.seconds)
        trained = f"{len(model.networks)} x {steps} steps, {seconds:.0f} s"
        if model.config.base == "grey_box":
            rows.append(of_base(f"{path.stem}, named effects alone", model.vehicle, recordings))
        rows.append(row(path.stem, trained, lab, true))
        flights[path.stem] = true
        if model.config.base == "grey_box":
            rows.append(row(f"{path.stem}, not gated", trained, *errors_of(model, data, gated=False)))
            base = [e.combined / e.base for e in true if e.base]
            flights["the same over its named effects alone"] = true
            print(f"{path.stem}: worst flight {max(base):.3f} of the named effects alone, wanted {FLOOR_RATIO}")
    nominal = next(iter(flights.values()))
    names = [error.flight.removesuffix(".parquet") for error in nominal]
    table = ["| model | " + " | ".join(names) + " |", "| --- |" + " --- |" * len(names)]
    table.append("| nominal | " + " | ".join(f"{error.nominal:.3f}" for error in nominal) + " |")
    for name, errors in flights.items():
        over = "over" in name
        cells = [f"{e.combined / e.base:.2f}" if over and e.base else f"{e.combined:.3f}" for e in errors]
        table.append(f"| {name} | " + " | ".join(cells) + " |")
    write_result(
        "trained_models",
        "Models beside the vehicle files, on the campaign's eight test flights",
        "RMSE, each component counting alike: linear (m/s^2) / angular (rad/s^2) / all. Labels: increments over 10 ms "
        "of velocity filtered at 5 Hz and rates at 12 Hz; truth: the simulator's own increments.\n\n"
        "| model | trained | against labels | against the truth | truth: over nominal | over its base |\n"
        "| --- | --- | --- | --- | --- | --- |\n" + "\n".join(rows) + "\n\nAgainst the truth, all components, by "
        "flight:\n\n" + "\n".join(table),
    )


if __name__ == "__main__":
    main()
