"""From PX4's logs of a drone to a flown, identified model, on one's own desk: what an hour with Alula consists of.

The drone's logs are recorded PX4 flights. The drone itself is the mock, which hides a drag that the logs' vehicle file
does not have. Prints what every step answers and how long it took.

    python examples/whole_hour.py [--logs 'tests/data/px4_sih_flights/nothing_*'] [--mass 1.0] [--arm 0.283]
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import alula

REQUEST = "identify:duration=40,box=6x6x4,for=drag+inertia"
HIDDEN = "linear_drag:coefficient=0.5"  # N s/m


@contextmanager
def step(name: str) -> Iterator[None]:
    """Print a step's name, and the time that it took."""
    began = time.monotonic()
    print(f"== {name}", flush=True)
    yield
    print(f"   {time.monotonic() - began:.1f} s", flush=True)


def main() -> None:
    """The whole hour."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--logs", default="tests/data/px4_sih_flights/nothing_*")
    parser.add_argument("--mass", type=float, default=1.0, help="kg, from a scale")
    parser.add_argument("--arm", type=float, default=0.283, help="m, from the centre to a motor's axis")
    parser.add_argument("--out", type=Path, default=Path("hour"))
    chosen = parser.parse_args()
    out: Path = chosen.out
    if out.exists():
        parser.error(f"{out} exists: give another --out.")
    out.mkdir(parents=True)
    began = time.monotonic()

    with step("a vehicle file from logs: alula vehicle from-log"):
        made = alula.vehicle_from_logs(chosen.logs, "mine", mass=chosen.mass, arm=chosen.arm)
        (out / "mine.toml").write_text(made.draft.toml)
        vehicle = alula.load_vehicle(out / "mine.toml")
        print(f"   {vehicle.rotors.count} rotors, {vehicle.body.mass:g} kg; open: {'; '.join(made.draft.open)}")

    with step("an identification flight: alula fly --reference identify"):
        planned = alula.plan_flight(vehicle, REQUEST, trial=False)
        reference = planned.write_csv(out / "identification_flight.csv")
        print("   " + planned.text.replace("\n", "\n   "))

    with step("flown on the mock, in lockstep"):
        flown = alula.simulate(str(reference), vehicle=vehicle, hidden=[HIDDEN], seed=1)
        log = out / "flight.csv"
        alula.Flight.from_log(flown.log).to_csv(log)
        print(f"   {flown.seconds:.0f} s, {flown.position_rmse:.3f} m RMS off the reference {flown.aborted}")

    with step("alula diagnose"):
        diagnosis = alula.diagnose(log, vehicle)
        print(f"   {diagnosis.sentence}")

    with step("alula add"):
        addition = alula.add_effect(log, out / "mine.toml")
        better = addition.write_next_version(out / "mine.toml")
        print(f"   {', '.join(use.label for use in addition.vehicle.effects)} in {better}")

    with step("alula export"):
        exported = alula.export(better, out / "bundle", windows=50)
        print(f"   {exported.summary[0]}")

    with step("the identified model flies, in lockstep"):
        again = alula.simulate(str(reference), bundle=out / "bundle", seed=2)  # a drone that has the drag, as before
        print(f"   {again.seconds:.0f} s, {again.position_rmse:.3f} m RMS off the reference {again.aborted}")

    print(f"whole hour: {time.monotonic() - began:.0f} s of computing")


if __name__ == "__main__":
    main()
