"""How the filter of the vehicle's clock follows clocks as PX4's simulator has them, recorded and made, and quiet ones.

A restart of the filter is an event of the flight and makes the clock invalid for half a second; before the filter
judged clocks by the spread of their own stamps, the recorded ones restarted it 17 to 37 times.

    python -m benchmarks.clock_filter [--seeds N]
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from benchmarks.provenance import write_result
from fixtures.vehicle_clock import PERIOD, START, Clock, Exchange, simulator_clock
from runtime.link.clock import VehicleClock

RECORDED = Path(__file__).parents[1] / "tests" / "data" / "px4_sih_flights" / "clocks.npz"
SECONDS = 60.0
SETTLED = 1.0  # s after which the clock has to be valid
HEADER = "| clock | restarts | invalid, s | steps followed | error RMS, ms | 99 % | greatest |"
# name, drift s/s, count s, round trip s, steps a minute
MADE = (
    ("drift -12 ms/s, counts in 4 ms, round trip 0.6 ms", -0.012, 4e-3, 6e-4, 6.0),
    ("the same, round trip 6 ms", -0.012, 4e-3, 6e-3, 6.0),
    ("drift +12 ms/s, counts in 4 ms", 0.012, 4e-3, 6e-4, 6.0),
    ("drift -12 ms/s, counts in 1 us", -0.012, 1e-6, 6e-4, 6.0),
    ("20 steps a minute", -0.012, 4e-3, 6e-4, 20.0),
    ("quiet: 20 ppm, round trip 3 ms", 2e-5, 1e-6, 3e-3, 0.0),
)


def row(name: str, clocks: Iterable[VehicleClock], steps: int, invalid: float, errors: list[float]) -> str:
    """A row of the table. errors: s."""
    error = 1e3 * np.array(errors)
    figures = f"{np.sqrt(np.mean(error**2)):.2f} | {np.percentile(error, 99):.1f} | {np.max(error):.1f}"
    return f"| {name} | {sum(clock.resets for clock in clocks)} | {invalid:.1f} | {steps} | {figures} |"


def made(name: str, drift: float, quantum: float, round_trip: float, steps: float, seeds: int) -> str:
    """The row of a made clock over some seeds; a count of 4 ms is an error of 1.2 ms RMS by itself."""
    clocks, followed, invalid, errors = [], 0, 0.0, []
    for seed in range(seeds):
        vehicle = simulator_clock(100 + seed, drift, quantum, SECONDS, steps)
        exchange = Exchange(round_trip, seed)
        exchange.run(SETTLED, vehicle)
        while exchange.now < START + SECONDS - 2.0:
            exchange.run(PERIOD, vehicle)
            invalid += PERIOD * (not exchange.clock.is_valid(exchange.now))
            errors.append(exchange.error(vehicle))
        clocks.append(exchange.clock)
        followed += exchange.verdicts.count("stepped")
    return row(f"{name} ({seeds} x {SECONDS:.0f} s)", clocks, followed, invalid, errors)


def recorded(name: str, ours: np.ndarray, vehicle: np.ndarray) -> str:
    """The row of a recorded clock; its error contains the link's delay and the clock's count, 4 ms each."""
    clock, verdicts, invalid, errors = VehicleClock(), [], 0.0, []
    for received, stamp in zip(ours.tolist(), vehicle.tolist(), strict=True):
        verdicts.append(clock.handle(received - 6e-4, received, stamp))
        if received > ours[0] + SETTLED:
            invalid += PERIOD * (not clock.is_valid(received))
            errors.append(abs(clock.to_vehicle(received) - stamp))
    return row(f"recorded: {name}", [clock], verdicts.count("stepped"), invalid, errors)


def noticed(jump: float, seeds: int) -> str:
    """How many true jumps, s, are noticed, and within which time."""
    times = []
    for seed in range(seeds):
        exchange, vehicle = Exchange(6e-4, seed), simulator_clock(200 + seed, -0.011, 4e-3, SECONDS)
        exchange.run(30.0, vehicle)
        before = len(exchange.verdicts)
        jumped: Clock = lambda ours, clock=vehicle: clock(ours) + jump  # type: ignore[misc]  # noqa: E731
        exchange.run(2.0, jumped)
        reports = [n for n, verdict in enumerate(exchange.verdicts[before:]) if verdict in ("jumped", "ran_backwards")]
        times += reports[:1]
    slowest = f"{PERIOD * (max(times) + 1):.1f} s" if times else "-"
    return f"| {jump:+g} s | {len(times)} of {seeds} | {slowest} |"


def main() -> None:
    """Measure and write the tables."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--seeds", type=int, default=10)
    seeds = parser.parse_args().seeds
    with np.load(RECORDED) as data:
        names = [name.removesuffix("_ours_usec") for name in data.files if name.endswith("_ours_usec")]
        rows = [
            recorded(name, 100 + data[f"{name}_ours_usec"] * 1e-6, 50 + data[f"{name}_vehicle_msec"] * 1e-3)
            for name in names
        ]
    rows += [made(*case, seeds) for case in MADE]
    jumps = [noticed(jump, seeds) for jump in (-30.0, -0.5, 0.1, 1.0)]
    table = [HEADER, "| --- | ---: | ---: | ---: | ---: | ---: | ---: |", *rows]
    table += [
        "",
        "True jumps on a simulator's clock:",
        "",
        "| jump | noticed | slowest |",
        "| --- | --- | --- |",
        *jumps,
    ]
    write_result("clock_filter", "The filter of the vehicle's clock", "\n".join(table))


if __name__ == "__main__":
    main()
