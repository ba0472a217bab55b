"""Parameters that are named in flight: a centre of mass, a battery's sag, the wind."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from operator import itemgetter
from typing import Any

import numpy as np

from benchmarks.adaptation import DRAG, MODES, VEHICLE
from benchmarks.measurement import Page, measured, options_of
from dynamics.references import named_reference
from dynamics.vehicle import EffectUse
from dynamics.vehicle_file import read_vehicle
from runtime.control.adaptation_settings import AdaptationSettings
from runtime.control.controller import Controller, ControllerOptions
from simulation.lockstep import fly_reference
from sitl_mock.vehicle.battery import usual_battery
from sitl_mock.vehicle.vehicle import VehicleOptions
from vehicles import FOLDER

VEHICLES = ("arpl_250g", "px4_sih", "crazyflie")
MANOEUVRES = ("Hover", "circle", "Ellipse_1", "line", "Lemniscate:speed=0.7")
KINDS = ("centre_of_mass", "battery_sag")
SECONDS = {"centre_of_mass": 12.0, "battery_sag": 60.0}
ENDURANCE = (90.0, 900.0)  # s of a battery: emptied by half in the flight, or hardly
SHOWN = 0.5  # of the prior's standard deviation: above it a flight does not show the parameter
FIRST_SEED = 83_000


def drawn(kind: str, number: int) -> dict[str, Any]:
    """A flight by its number; in every third nothing is hidden."""
    random = np.random.default_rng((FIRST_SEED, number, KINDS.index(kind)))
    return {
        "key": f"{kind} {number}",
        "kind": kind,
        "seed": FIRST_SEED + number,
        "vehicle": str(random.choice(VEHICLES)),
        "reference": str(random.choice(MANOEUVRES)),
        "sizes": random.uniform(-1.0, 1.0, size=2).tolist() if number % 3 else [0.0, 0.0],
        "endurance": ENDURANCE[number % 2],
    }


def flown(case: Mapping[str, Any]) -> dict[str, Any]:
    """Values as they were named, and true ones."""
    vehicle, kind = read_vehicle(FOLDER / f"{case['vehicle']}.toml"), case["kind"]
    arm = float(np.abs(np.array(vehicle.rotors.position)[:, 0]).mean())
    x, y = (0.15 * arm * float(size) for size in case["sizes"])
    hidden = {
        "centre_of_mass": {"x": x, "y": y, "z": 0.0, "sensors_stay": 1.0},
        "battery_sag": {"gain": abs(case["sizes"][0]), "reference": 1.0},
    }[kind]
    settings = AdaptationSettings(mode="on", follow=(kind,))
    controller = Controller.build(vehicle, ControllerOptions.for_vehicle(vehicle, adaptation=settings))
    endurance = case["endurance"] if kind == "battery_sag" else ENDURANCE[1]
    flight = fly_reference(
        vehicle,
        named_reference(case["reference"], vehicle, duration=SECONDS[kind]),
        effects=[EffectUse(kind, hidden)],
        options=VehicleOptions(battery=usual_battery(vehicle, endurance=endurance), yaw=0.0),
        seed=case["seed"],
        controller=controller,
    )
    assert controller.adaptation is not None
    followed = controller.adaptation.followed.parameters
    names = ("x", "y") if kind == "centre_of_mass" else ("gain",)
    prior = {p.name: p.std for p in controller.adaptation.filter.parameters}
    rows = [(f"{kind}.{name}", hidden[name]) for name in names]
    return {
        **case,
        "named": [[name, true, followed[name].value, followed[name].std, prior[name]] for name, true in rows],
        "changed": controller.adaptation.changed,
        "aborted": flight.aborted,
    }


def table(results: Sequence[Mapping[str, Any]]) -> str:
    """By parameter, and by battery."""
    body = [
        f"{len(results)} flights on {', '.join(VEHICLES)}, of "
        f"{', '.join(f'{s:g} s ({k})' for k, s in SECONDS.items())}; in every third the vehicle is as in its file. "
        "Shown: with a standard deviation below half of the prior's. Off: median distance from the truth, and nine of "
        "ten. Named: that it is not as in the file, by three deviations.",
        "",
        "| parameter | battery | flights | shown | off | nine of ten | deviation | 95 % hold | named, of none |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    body += [_row(name, "any", results) for name in ("centre_of_mass.x", "centre_of_mass.y")]
    for endurance in ENDURANCE:
        some = [r for r in results if r["endurance"] == endurance]
        body.append(_row("battery_sag.gain", f"{endurance:g} s", some))
    ended = [f"{r['key']}: {r['aborted']}" for r in results if r["aborted"]]
    return "\n".join([*body, "", f"Flights that ended early: {'; '.join(ended) or 'none'}."])


def _row(name: str, battery: str, results: Sequence[Mapping[str, Any]]) -> str:
    rows = [(r["changed"], *row[1:]) for r in results for row in r["named"] if row[0] == name]
    shown = [row for row in rows if row[3] < SHOWN * row[4]]
    cells = [name, battery, f"{len(rows)}", f"{len(shown)}"]
    if shown:
        off = [abs(value - true) for _, true, value, _, _ in shown]
        holds = sum(abs(value - true) <= 1.96 * std for _, true, value, std, _ in shown)
        cells += [
            f"{np.median(off):.2g}",
            f"{np.quantile(off, 0.9):.2g}",
            f"{np.median([row[3] for row in shown]):.2g}",
        ]
        cells.append(f"{holds} of {len(shown)}")
    else:
        cells += [""] * 4
    none = [changed for changed, true, *_ in rows if true == 0.0]
    cells.append(f"{sum(name in changed for changed in none)} of {len(none)}")
    return f"| {' | '.join(cells)} |"


def parameters(words: Sequence[str]) -> Page:
    """A centre of mass, and how thrust goes with voltage, named in flight. Writes results/named_parameters.md.

    In lockstep on random vehicles of the mock, manoeuvres and values, with measured rotor speeds and a battery of some
    minutes. Finished flights are kept, so that a run that was stopped resumes.

        python -m benchmarks adaptation parameters --flights 20
    """
    options = options_of(parameters.__doc__, resumes="named_parameters", jobs=1, flights=20).parse_args(words)
    cases = [drawn(kind, number) for kind in KINDS for number in range(options.flights)]
    results = measured(flown, cases, options, spoken, key_of=itemgetter("key"))
    return Page("named_parameters", "A centre of mass and a battery's sag, named in flight", table(results))


def spoken(result: Mapping[str, Any]) -> str:
    """A line about a flight."""
    return f"{result['key']} {result['vehicle']} {result['reference']}: {result['named']}"


WIND_MANOEUVRES = ("hover", "line", "circle", "Ellipse_1")
WINDS = (2.0, 10.0)  # m/s
DRAG_ERROR = 0.05  # standard deviation, as a share of it
WIND_SECONDS = 20.0
WIND_FIRST_SEED = 87_000


def wind_drawn(number: int) -> dict[str, Any]:
    """A flight by its number."""
    random = np.random.default_rng((WIND_FIRST_SEED, number))
    speed, heading = random.uniform(*WINDS), random.uniform(0.0, 2 * np.pi)
    return {
        "key": number,
        "reference": WIND_MANOEUVRES[number % len(WIND_MANOEUVRES)],
        "wind": [float(speed * np.cos(heading)), float(speed * np.sin(heading))],
        "share": float(1.0 + DRAG_ERROR * random.normal()),
    }


def wind_flown(case: Mapping[str, Any]) -> dict[str, Any]:
    """Named effects at the end of a flight, with standard deviations."""
    vehicle = read_vehicle(FOLDER / f"{VEHICLE}.toml")
    name, values = DRAG
    coefficient = values["coefficient"]
    identified = vehicle.with_effects(EffectUse(name, {"coefficient": case["share"] * coefficient}))
    mode, follow = MODES["named"]
    settings = AdaptationSettings(mode=mode, follow=follow)  # type: ignore[arg-type]
    controller = Controller.build(identified, ControllerOptions.for_vehicle(identified, adaptation=settings))
    x, y = case["wind"]
    flight = fly_reference(
        vehicle,
        named_reference(case["reference"], identified, duration=WIND_SECONDS),
        effects=[EffectUse(name, values), EffectUse("wind", {"x": x, "y": y, "z": 0.0})],
        seed=WIND_FIRST_SEED + case["key"],
        controller=controller,
    )
    assert controller.adaptation is not None
    followed = controller.adaptation.followed.parameters
    named = [[followed[f"wind.{axis}"].value, followed[f"wind.{axis}"].std] for axis in "xy"]
    return {**case, "named": named, "aborted": flight.aborted}


def wind_table(results: Sequence[Mapping[str, Any]]) -> str:
    """By manoeuvre: how far off the wind's speed is, and how many intervals of 90 % hold."""
    body = [
        f"{VEHICLE} in winds of {WINDS[0]:g} to {WINDS[1]:g} m/s, {WIND_SECONDS:g} s; its file has rotor_drag, "
        f"{DRAG_ERROR:.0%} off. True: speed within 10 % or 0.3 m/s. Intervals: of wind.x and wind.y.",
        "",
        "| reference | flights | off, median, m/s | nine of ten | true | 90 % intervals hold | median deviation, m/s |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for reference in (*WIND_MANOEUVRES, "all"):
        some = [r for r in results if reference in (r["reference"], "all")]
        if some:
            body.append(f"| {reference} | {len(some)} | {' | '.join(_cells(some))} |")
    ended = [f"{r['key']}: {r['aborted']}" for r in results if r["aborted"]]
    return "\n".join([*body, "", f"Flights that ended early: {'; '.join(ended) or 'none'}."])


def _cells(some: Sequence[Mapping[str, Any]]) -> list[str]:
    true, named = np.array([r["wind"] for r in some]), np.array([r["named"] for r in some])
    speed, estimate = np.linalg.norm(true, axis=1), np.linalg.norm(named[:, :, 0], axis=1)
    off = np.abs(estimate - speed)
    holds = np.abs(named[:, :, 0] - true) < 1.645 * named[:, :, 1]
    return [
        f"{np.median(off):.2f}",
        f"{np.quantile(off, 0.9):.2f}",
        f"{np.count_nonzero(off < np.maximum(0.1 * speed, 0.3))}",
        f"{np.count_nonzero(holds)} of {holds.size}",
        f"{np.median(named[:, :, 1]):.2f}",
    ]


def wind_spoken(result: Mapping[str, Any]) -> str:
    """A line about a flight."""
    return f"{result['key']} {result['reference']}: {result['wind']} {result['named']} {result['aborted']}"


def wind(words: Sequence[str]) -> Page:
    """The wind of a steady flight, named by a vehicle whose file has its drag. Writes results/steady_wind.md.

    In lockstep on random winds; the file's drag is 5 % off, as one of a diagnosis is. Finished flights are kept, so
    that a run that was stopped resumes.

        python -m benchmarks adaptation wind --flights 40
    """
    options = options_of(wind.__doc__, resumes="steady_wind", jobs=1, flights=40).parse_args(words)
    results = measured(
        wind_flown, map(wind_drawn, range(options.flights)), options, wind_spoken, key_of=itemgetter("key")
    )
    return Page("steady_wind", "The wind of a steady flight", wind_table(results))
