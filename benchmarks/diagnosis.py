"""The diagnosis: its time. `benchmarks.verdict` judges its answers."""

from __future__ import annotations

import os
import subprocess
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from statistics import median

from benchmarks.measurement import ROOT, Page, options_of, own_command
from diagnosis.data.dataset import Dataset, make_dataset, read_dataset
from diagnosis.diagnose import diagnose_dataset
from dynamics.effects import CATALOGUE
from dynamics.vehicle import EffectUse, Vehicle
from dynamics.vehicle_file import read_vehicle
from fixtures.campaign_logs import campaign_logs
from fixtures.compiled_flights import compiled_flights
from fixtures.outside_draws import Draw, written
from vehicles import FOLDER

REPEATS = 3
ENVIRONMENT = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}  # as the command has it
DRAG = [EffectUse("rotor_drag", {"coefficient": 2.2e-5})]
PX4 = ROOT / "tests" / "data" / "px4_sih_flights"


def compiled(uses: list[EffectUse], sets: int) -> tuple[Dataset, Vehicle]:
    """Sets of nine flights by measured speeds at 100 Hz."""
    vehicle = read_vehicle(FOLDER / "arpl_250g.toml")
    flights = [
        flight
        for seed in range(sets)
        for flight in compiled_flights(vehicle, uses, catalogue=CATALOGUE, seed=60 + seed, noise=1.0)
    ]
    return make_dataset(flights, vehicle), vehicle


def px4() -> tuple[Dataset, Vehicle]:
    """Two of PX4's flights, by commands with its estimator's pose at 250 Hz."""
    vehicle = read_vehicle(FOLDER / "px4_sih.toml")
    logs = [PX4 / f"{name}.ulg.gz" for name in ("drag2_1_circle", "drag2_4_lemniscate")]
    return read_dataset(logs, vehicle), vehicle


def outside(draw: Draw) -> tuple[Dataset, Vehicle]:
    """A campaign of the outside simulator."""
    with tempfile.TemporaryDirectory() as folder:
        logs = written(draw, Path(folder))
        vehicle = read_vehicle(Path(folder) / "vehicle.toml")
        return read_dataset(logs, vehicle), vehicle


def campaign() -> tuple[Dataset, Vehicle]:
    """Ten flights of a campaign with its nine effects."""
    vehicle = read_vehicle(FOLDER / "arpl_250g.toml")
    with tempfile.TemporaryDirectory() as folder:
        logs = []
        for name, content in campaign_logs(nine=True, seed=1).items():
            logs.append(Path(folder) / name)
            logs[-1].write_bytes(content)
        return read_dataset(logs, vehicle), vehicle


TIMED: Mapping[str, tuple[Callable[[], tuple[Dataset, Vehicle]], float | None]] = {  # and the goal, s for 100 s
    "rotor drag, nine flights": (partial(compiled, DRAG, 1), 2.5),
    "nothing, nine flights": (partial(compiled, [], 1), 2.5),
    "rotor drag, 54 flights": (partial(compiled, DRAG, 6), 2.5),
    "nine effects, ten flights": (campaign, 3.7),  # 15 s for ten flights
    "inertia, outside simulator": (partial(outside, Draw("single", "inertia", 1)), 2.5),
    "slung load, outside simulator": (partial(outside, Draw("single", "slung_load", 1)), 2.5),
    "nothing, outside simulator, commands": (partial(outside, Draw("nothing", "commands", 1)), None),
    "nothing, outside simulator, estimator's pose": (partial(outside, Draw("nothing", "estimator", 1)), None),
    "drag, PX4's own simulation, two flights": (px4, None),
}


def timed(name: str) -> str:
    """A kind's line of the table."""
    made, goal = TIMED[name]
    data, vehicle = made()
    taken = []
    for _ in range(1 + REPEATS):
        began = time.process_time()
        diagnose_dataset(data, vehicle, CATALOGUE)
        taken.append(time.process_time() - began)
    flown = sum(s.duration for s in data.everything)
    one, first, seconds = data.fitted[0], taken[0], median(taken[1:])
    rotors = "speeds" if one.rotor_source == "measured" else "commands"
    cells = [name, rotors, f"{one.rate:.0f}", f"{flown:.0f}", f"{first:.1f}", f"{seconds:.1f}"]
    cells += [f"{100 * each / flown:.2f}" for each in (first, seconds)]
    return "| " + " | ".join([*cells, "-" if goal is None else f"{goal:g}"]) + " |"


def speed(words: Sequence[str]) -> Page | None:
    """Time of a diagnosis, by kind of flight: processor seconds for 100 s of it, one thread a library.

    Flights by speeds and by commands, slow and fast, of our own simulator, of one that is not ours and of PX4. Each
    kind has a process of its own: the first diagnosis there builds the models, three more find them built. Reading
    files is not counted. Flights of the outside simulator and of a campaign are flown first where they are not kept.

        python -m benchmarks diagnosis speed [--kind NAME ..]
    """
    options = options_of(speed.__doc__)
    options.add_argument("--kind", nargs="+", choices=TIMED, default=list(TIMED), help="kinds to time")
    options.add_argument("--line", action="store_true", help="print the one kind's line of the table")
    chosen = options.parse_args(words)
    if chosen.line:
        print(timed(chosen.kind[0]))
        return None
    own = own_command("diagnosis", "speed", "--line", "--kind")
    lines = [
        "Processor seconds of the first diagnosis in a process and the median of three more.",
        "",
        "| hidden, flights | rotors | Hz | s flown | first | median | first, for 100 s | median, for 100 s | goal |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- |",
        *(subprocess.check_output([*own, kind], env=ENVIRONMENT, text=True).strip() for kind in chosen.kind),
    ]
    return Page("diagnosis_speed", "Time of a diagnosis", "\n".join(lines))
