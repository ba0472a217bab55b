"""How long diagnosis takes: 108 s of nine flights, and ten minutes of fifty-four, one thread a library.

Each size is diagnosed three times in a process that has done so once before; reading files is not counted.

    python -m benchmarks.diagnosis_speed
"""

from __future__ import annotations

import os
import sys
import time
from statistics import median

from benchmarks.provenance import write_result
from diagnosis.data.dataset import make_dataset
from diagnosis.diagnose import diagnose_dataset
from dynamics.effects import CATALOGUE
from dynamics.vehicle import EffectUse
from dynamics.vehicle_file import read_vehicle
from fixtures.compiled_flights import compiled_flights
from runtime.realtime import limit_library_threads
from vehicles import FOLDER

SETS = {"108 s": (1, 2.0), "10 minutes": (6, 10.0)}  # of nine flights each, and the goal, s
REPEATS = 3
HIDDEN = {"rotor_drag": [EffectUse("rotor_drag", {"coefficient": 2.2e-5})], "nothing": []}


def main() -> None:
    if os.environ.get("OPENBLAS_NUM_THREADS") != "1":  # as the command has it; read when the library is loaded
        limit_library_threads()
        os.environ["OPENBLAS_NUM_THREADS"] = "1"
        os.execv(sys.executable, sys.orig_argv)
    vehicle = read_vehicle(FOLDER / "arpl_250g.toml")
    lines = [
        "| flight | hidden | seconds of flight | processor seconds, median | by the clock | goal |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for name, (sets, goal) in SETS.items():
        for hidden, uses in HIDDEN.items():
            flights = [
                flight
                for seed in range(sets)
                for flight in compiled_flights(vehicle, uses, catalogue=CATALOGUE, seed=60 + seed, noise=1.0)
            ]
            data = make_dataset(flights, vehicle)
            diagnose_dataset(data, vehicle, CATALOGUE)
            taken = []
            for _ in range(REPEATS):
                began = time.process_time(), time.perf_counter()
                diagnose_dataset(data, vehicle, CATALOGUE)
                taken.append((time.process_time() - began[0], time.perf_counter() - began[1]))
            flown = sum(s.duration for s in data.everything)
            figures = (median(t for t, _ in taken), median(t for _, t in taken))
            lines.append(f"| {name} | {hidden} | {flown:.0f} | {figures[0]:.1f} | {figures[1]:.1f} | {goal:.0f} |")
    write_result("diagnosis_speed", "Time of a diagnosis", "\n".join(lines))


if __name__ == "__main__":
    main()
