"""A vehicle's constants from its flights: estimates beside the truth, and how many intervals of 95 % hold it.

PX4's simulated quadrotor of known constants (tests/data/px4_sih_flights: real firmware, commands alone), and flights of
the mock's 250 g vehicle with inertia, lag and drag drawn at random, with measured rotor speeds. The estimation starts
from the rules of `alula vehicle new`. The PX4 sets are those that the model error in every interval was taken from;
the mock's are fresh.

    python -m benchmarks estimation vehicle_from_logs [--seeds 6] [--first-seed 500]
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain, islice
from pathlib import Path

import msgspec
import numpy as np

from benchmarks.measurement import Page, options_of
from diagnosis.data.dataset import read_flights
from diagnosis.vehicle_identification import Constant, Identification, identify_vehicle
from dynamics.references import named_reference
from dynamics.vehicle import EffectUse, Vehicle
from dynamics.vehicle_file import find_vehicle, read_vehicle
from dynamics.vehicle_sizing import inertia_by_rule
from flights import Flight, Log
from simulation.lockstep import fly_reference
from sitl_mock.vehicle.vehicle import VehicleOptions

LOGS = Path("tests/data/px4_sih_flights")
SETS = {
    "nothing": (1.0, 0.05),
    "drag2": (1.0, 0.05),
    "mass125": (1.25, 0.05),
    "lag90": (1.0, 0.09),
    "textbook": (1.0, 0.05),
}
Pair = tuple[Constant, float]


def started(vehicle: Vehicle, mass: float) -> Vehicle:
    """A vehicle of this layout and mass as the rules have it, without effects."""
    arm = float(np.max(np.linalg.norm(np.array(vehicle.rotors.position)[:, :2], axis=1)))
    body = msgspec.structs.replace(vehicle.body, mass=mass, inertia=inertia_by_rule(mass, arm))
    rotors = msgspec.structs.replace(vehicle.rotors, torque_constant=0.016 * vehicle.rotors.thrust_constant)
    return msgspec.structs.replace(vehicle, body=body, rotors=rotors, effects=())


def of_px4() -> Iterator[tuple[str, dict[str, Pair]]]:
    """Name of each set, and (estimate, truth) by constant."""
    file = read_vehicle(find_vehicle("px4_sih"))
    for name, (mass, lag) in SETS.items():
        identified = identify_vehicle(read_flights(sorted(LOGS.glob(f"{name}_*.ulg.gz"))), started(file, mass))
        pairs = {"thrust": (identified.thrust, 20.0), **_pairs(identified, (0.025, 0.025, 0.03), 1e-7 / 0.03)}
        if identified.motor_lag is not None:
            pairs["motor lag"] = (identified.motor_lag, lag)
        yield f"PX4, {name}", pairs


def of_mock(seeds: Sequence[int]) -> Iterator[tuple[str, dict[str, Pair]]]:
    """Numbers and truths of drawn vehicles."""
    file = read_vehicle(find_vehicle("arpl_250g"))
    for seed in seeds:
        random = np.random.default_rng(seed)
        ratios = dict(zip(("ratio_x", "ratio_y", "ratio_z"), random.uniform(0.8, 1.25, 3).tolist(), strict=True))
        lag, drag = random.uniform(0.02, 0.045), random.uniform(0.5, 2.0) * 2e-5
        hidden = [
            EffectUse("inertia", ratios),
            EffectUse("motor_lag", {"time_constant": lag}),
            EffectUse("rotor_drag", {"coefficient": drag}),
        ]
        reference = named_reference("Lemniscate:laps=9,speed=0.8", file)
        start = reference.states(np.zeros(1))[0]
        options = VehicleOptions(position=(float(start[0]), float(start[1])))
        flown = fly_reference(file, reference, effects=hidden, options=options, seed=seed)
        if flown.aborted:
            print(f"mock, seed {seed}: not flown to its end: {flown.aborted}")
            continue
        identified = identify_vehicle(
            [Flight.from_log(_measured(flown.log), rate=100.0)], started(file, file.body.mass)
        )
        x, y, z = (own * ratio for own, ratio in zip(file.body.inertia, ratios.values(), strict=True))
        pairs = _pairs(identified, (x, y, z), file.rotors.torque_constant / z)
        yield (
            f"mock, seed {seed}",
            {"thrust constant": (identified.thrust_constant, file.rotors.thrust_constant), **pairs},
        )


def _measured(log: Log) -> Log:
    """The log without commands."""
    return replace(
        log, streams=tuple(s for s in log.streams if not s.name.startswith(("rotor_command", "rotor_speed_c")))
    )


def _pairs(identified: Identification, inertia: tuple[float, float, float], yaw_gain: float) -> dict[str, Pair]:
    estimates = (*identified.inertia, identified.yaw_inertia)
    about = zip("xyz", estimates, inertia, strict=True)
    inertias = {f"inertia {axis}": (own, truth) for axis, own, truth in about if own is not None}
    return {**inertias, "yaw gain": (identified.yaw_gain, yaw_gain)}


def table(results: Mapping[str, Mapping[str, Pair]]) -> str:
    """Estimate over truth with half of the interval, in per cent, one row a set; * where the interval misses it."""
    names = list(dict.fromkeys(name for pairs in results.values() for name in pairs))
    lines = [f"| flights | {' | '.join(names)} |", "| --- " * (len(names) + 1) + "|"]
    for flights, pairs in results.items():
        cells = [_cell(*pairs[name]) if name in pairs else "" for name in names]
        lines.append(f"| {flights} | {' | '.join(cells)} |")
    return "\n".join(lines)


def _cell(constant: Constant, truth: float) -> str:
    error, width = 100 * (constant.value / truth - 1), 100 * constant.half_width / truth
    return f"{error:+.1f} % ± {width:.1f}{'' if abs(error) <= width else ' *'}"


def vehicle_from_logs(words: Sequence[str]) -> Page:
    """The measurement's page."""
    parser = options_of(__doc__, seeds=6, first_seed=500)
    parser.add_argument("--sets", type=int, help="so many of PX4's and the mock's sets alone")
    arguments = parser.parse_args(words)
    seeds = range(arguments.first_seed, arguments.first_seed + arguments.seeds)
    results: dict[str, dict[str, Pair]] = {}
    for name, pairs in islice(chain(of_px4(), of_mock(seeds)), arguments.sets):
        results[name] = pairs
        print(name, {key: _cell(*pair) for key, pair in pairs.items()}, flush=True)
    holds = [abs(c.value - truth) <= c.half_width for pairs in results.values() for c, truth in pairs.values()]
    text = f"{table(results)}\n\n{sum(holds)} of {len(holds)} intervals hold the truth.\n"
    return Page("vehicle_from_logs", "A vehicle's constants from its flights", text)
