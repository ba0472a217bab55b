"""How much faster than real time plant and controller fly together in one process on one core.

`simulation.lockstep.fly_reference` runs the flight logic and controller of `alula fly` at 100 Hz against the mock's
vehicle (1 ms steps, inner loops, sensors, battery), without MAVLink. The climb to the start is in the time spent but
not in the time simulated.

    python -m benchmarks.lockstep_speed [--repeats 5]
"""

from __future__ import annotations

import argparse
import os
import time

import numpy as np

from benchmarks.provenance import write_result
from dynamics.references import named_reference
from dynamics.vehicle_file import read_vehicle
from runtime.control.controller import Controller
from simulation.lockstep import fly_reference
from vehicles import FOLDER

NAMES = ("Ellipse_1", "WarpedEllipse_2", "Lemniscate", "TransposedParabola")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=5)
    repeats = parser.parse_args().repeats
    os.sched_setaffinity(0, {0})
    vehicle = read_vehicle(FOLDER / "arpl_250g.toml")
    fly_reference(vehicle, named_reference("circle:laps=1", vehicle), controller=Controller.build(vehicle))
    rows = ["| manoeuvre | simulated s | times real time, processor time | wall time |", "| --- " * 4 + "|"]
    for name in NAMES:
        reference = named_reference(name, vehicle)
        factors = []
        for repeat in range(repeats):
            controller = Controller.build(vehicle)
            spent, began = time.process_time(), time.perf_counter()
            flown = fly_reference(vehicle, reference, seed=repeat, controller=controller)
            spent, wall = time.process_time() - spent, time.perf_counter() - began
            if flown.aborted:
                raise SystemExit(f"{name} ended early: {flown.aborted}")
            factors.append((reference.duration / spent, reference.duration / wall))
        processor, wall_factor = np.median(factors, axis=0)
        rows.append(f"| {name} | {reference.duration:.1f} | {processor:.1f} | {wall_factor:.1f} |")
    load = os.getloadavg()[0]
    rows += ["", f"Medians of {repeats} runs, pinned to one core, load average {load:.1f}."]
    write_result("lockstep_speed", "Plant and controller in lockstep", "\n".join(rows))


if __name__ == "__main__":
    main()
