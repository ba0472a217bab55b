"""Rotors that lose thrust in flight: which is named, and when."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.measurement import Page, measured, options_of
from dynamics.controller_settings import CONTROL_PERIOD
from dynamics.effects import CATALOGUE
from dynamics.errors import VehicleError
from dynamics.references import named_reference
from dynamics.vehicle import EffectUse
from dynamics.vehicle_file import read_vehicle
from runtime.control.adaptation_settings import AdaptationSettings
from runtime.control.controller import Controller, ControllerOptions
from runtime.control.rotor_watch import RotorWatch
from runtime.daemon import Daemon
from runtime.flight.composition import Controllers
from runtime.flight.events import Event
from runtime.flight.mission import Plan
from runtime.flight_request import FlightRequest
from runtime.link.connection import parse_endpoint
from runtime.record.recording import read_recording
from simulation.lockstep import ParameterStep, fly_reference
from simulation.mock_process import mock_process
from simulation.whole_flight import fly_whole
from sitl_mock.autopilot.fault_schedule import Fault
from sitl_mock.mock import MockOptions
from sitl_mock.scenario import Scenario
from vehicles import FOLDER

VEHICLES = ("arpl_250g", "px4_sih", "crazyflie")
MANOEUVRES = ("Hover", "Lemniscate", "circle", "line", "Ellipse_1", "WarpedEllipse_1")
AIR: Mapping[str, tuple[tuple[str, dict[str, float]], ...]] = {
    "still air": (),
    "gusts of 0.5 m/s": (("rotor_drag", {"coefficient": 2.2e-5}), ("gust", {"intensity": 0.5})),
    "wind of 3 m/s": (("rotor_drag", {"coefficient": 2.2e-5}), ("wind", {"x": 3.0, "y": 0.0, "z": 0.0})),
}
OTHERS = ("nothing", "payload dropped", "payload taken up", "centre of mass", "payload off the centre", "wind rises")
LOSS, SECONDS, PATIENCE = 0.15, 15.0, 5.0
FIRST_SEED = 53_000  # settings were chosen on others


def drawn(kind: str, number: int) -> dict[str, Any]:
    """A flight by its number. kind: "loss", or "other" for what is no rotor's."""
    random = np.random.default_rng((FIRST_SEED, number, kind == "loss"))
    vehicle = str(random.choice(VEHICLES))
    air = str(random.choice(list(AIR))) if vehicle == "arpl_250g" else "still air"
    return {
        "key": f"{kind} {number}",
        "vehicle": vehicle,
        "reference": str(random.choice(MANOEUVRES)),
        "air": air,
        "rotor": int(random.integers(4)) if kind == "loss" else None,
        "what": "rotor" if kind == "loss" else OTHERS[number % len(OTHERS)],
        "at": float(random.uniform(5.0, 9.0)),
        "sizes": random.uniform(-1.0, 1.0, size=2).tolist(),
    }


def happening(case: Mapping[str, Any], arm: float) -> tuple[list[EffectUse], dict[str, float]]:
    """Effects as they are before, and the parameters that change."""
    mass = EffectUse("mass", {"ratio": 1.0})
    centre = EffectUse("centre_of_mass", {"x": 0.0, "y": 0.0, "z": 0.0, "sensors_stay": 1.0})
    x, y = (0.15 * arm * float(size) for size in case["sizes"])
    match case["what"]:
        case "rotor":
            use = EffectUse("weak_rotor", {"loss": 0.0, "torque_loss": 0.0}, case["rotor"])
            return [use], {f"{use.label}.loss": LOSS}
        case "payload dropped":
            return [mass], {"mass.ratio": 0.8}
        case "payload taken up":
            return [mass], {"mass.ratio": 1.2}
        case "centre of mass":
            return [centre], {"centre_of_mass.x": x, "centre_of_mass.y": y}
        case "payload off the centre":
            return [mass, centre], {"mass.ratio": 1.2, "centre_of_mass.x": x, "centre_of_mass.y": y}
        case "wind rises":
            drag = EffectUse("rotor_drag", {"coefficient": 2.2e-5})
            return [drag, EffectUse("wind", {"x": 0.0, "y": 0.0, "z": 0.0})], {"wind.x": 4.0}
        case _:
            return [], {}


def flown(case: Mapping[str, Any]) -> dict[str, Any]:
    """Named effects, s after it happened, and errors before and after, m.

    Where the mock's own autopilot is blown past the reference's start, another seed.
    """
    for attempt in range(5):
        try:
            return _flown(case, FIRST_SEED + int(case["key"].split()[1]) + 1000 * attempt)
        except VehicleError as error:
            print(f"{case['key']}: {error}", flush=True)
    raise VehicleError(f"{case['key']}: no seed of five reaches the reference's start.")


def _flown(case: Mapping[str, Any], seed: int) -> dict[str, Any]:
    vehicle = read_vehicle(FOLDER / f"{case['vehicle']}.toml")
    arm = float(np.abs(np.array(vehicle.rotors.position)[:, 0]).mean())
    before, step = happening(case, arm)
    there = {use.name for use in before}
    air = AIR[case["air"]] if case["what"] != "wind rises" else ()
    effects = [EffectUse(n, {**CATALOGUE[n].defaults(vehicle), **v}) for n, v in air if n not in there]
    settings = AdaptationSettings(mode="on")
    controller = Controller.build(vehicle, ControllerOptions.for_vehicle(vehicle, adaptation=settings))
    assert controller.adaptation is not None
    watch = controller.adaptation.rotors
    assert watch is not None
    named: list[tuple[float, int, float, float]] = []
    _note_names(watch, named)
    reference = named_reference(case["reference"], vehicle, duration=SECONDS)
    flight = fly_reference(
        vehicle,
        reference,
        effects=[*effects, *before],
        seed=seed,
        controller=controller,
        steps=[ParameterStep(case["at"], step)],
    )
    position, setpoint = flight.truth.stream("position"), flight.log.stream("position_setpoint")
    assert position is not None
    assert setpoint is not None
    error = np.linalg.norm(position.values - setpoint.values, axis=1)
    early, late = position.time < case["at"], position.time > case["at"] + 2.0
    began = controller.adaptation.newest - flight.seconds  # of the reference, on the flight's clock
    return {
        **case,
        "named": [(time - began - case["at"], rotor, share, std) for time, rotor, share, std in named],
        "before": float(np.sqrt(np.mean(error[early] ** 2))),
        "after": float(np.sqrt(np.mean(error[late] ** 2))) if late.any() else float("nan"),
        "worst": float(error[~early].max()),
        "aborted": flight.aborted,
    }


def _note_names(watch: RotorWatch, named: list[tuple[float, int, float, float]]) -> None:
    update = watch.update

    def noted() -> None:
        count = len(watch.losses)
        update()
        if len(watch.losses) > count:
            loss = watch.losses[-1]
            named.append((watch.speeds.newest, loss.rotor, loss.share, loss.deviation))

    watch.update = noted  # type: ignore[method-assign]


def table(results: Sequence[Mapping[str, Any]]) -> str:
    """Losses by vehicle, then what was named though it was none."""
    body = [
        f"A rotor loses {LOSS:.0%} of its thrust in flight, its torque stays. Named right: within {PATIENCE:g} s. "
        "Interval: 95 %, of the losses that were named. Tracking: error from 2 s after the loss over the one before.",
        "",
        "| vehicle | flights | named right | wrong rotor | never | s until named, median (worst) | loss, median | "
        "interval holds | tracking, median (worst) |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    losses = [result for result in results if result["what"] == "rotor"]
    for name in (*VEHICLES, "all"):
        some = [r for r in losses if name in (r["vehicle"], "all")]
        if some:
            body.append(_row(name, some))
    body += ["", "Something else happens: flights in which a rotor was named.", ""]
    body += ["| what | flights | a rotor was named |", "| --- | --- | --- |"]
    for what in OTHERS:
        some = [r for r in results if r["what"] == what]
        body.append(f"| {what} | {len(some)} | {sum(bool(r['named']) for r in some)} |")
    return "\n".join(body)


def _row(name: str, some: Sequence[Mapping[str, Any]]) -> str:
    first = [r["named"][0] if r["named"] else None for r in some]
    right = [n for r, n in zip(some, first, strict=True) if n is not None and n[1] == r["rotor"] and n[0] >= 0]
    wrong = sum(any(n[1] != r["rotor"] or n[0] < 0 for n in r["named"]) for r in some)
    soon = sum(n[0] <= PATIENCE for n in right)
    holds = sum(abs(n[2] - LOSS) <= 1.96 * n[3] for n in right)
    ratio = [r["after"] / r["before"] for r in some if np.isfinite(r["after"])]
    times = [n[0] for n in right]
    return (
        f"| {name} | {len(some)} | {soon} | {wrong} | {sum(n is None for n in first)} | {np.median(times):.1f} "
        f"({max(times):.1f}) | {np.median([n[2] for n in right]):.3f} | {holds} of {len(right)} | "
        f"{np.median(ratio):.2f} ({max(ratio):.2f}) |"
    )


def lockstep(words: Sequence[str]) -> Page:
    """Flights in which a rotor loses thrust, and flights in which something else happens: which rotor is named, and
    when.

    In lockstep, with measured rotor speeds, on vehicles and manoeuvres drawn by the seed. Writes results/rotor_loss.md.
    Finished flights are kept, so that a run that was stopped resumes.

        python -m benchmarks rotor_loss lockstep --flights 200 --others 100 --jobs 2
    """
    options = options_of(lockstep.__doc__, resumes="rotor_loss", jobs=2, flights=200, others=100).parse_args(words)
    cases = [drawn("loss", n) for n in range(options.flights)] + [drawn("other", n) for n in range(options.others)]
    results = measured(flown, cases, options, spoken, key_of=itemgetter("key"))
    return Page("rotor_loss", "A rotor that loses thrust in flight", table(results))


def spoken(result: Mapping[str, Any]) -> str:
    """A line about a flight."""
    return f"{result['key']} {result['vehicle']} {result['reference']}: {result['named']}"


LINK_MANOEUVRES = ("Hover", "circle", "line", "Ellipse_1", "WarpedEllipse_1", "Lemniscate")
MESSAGES = ("ESC_STATUS", "SERVO_OUTPUT_RAW")
ESTIMATORS = ("mocap", "px4")
AFTER_TAKE_OFF, LINK_SECONDS = 9.0, 14.0
LINK_FIRST_SEED = 58_000
ON = AdaptationSettings(mode="on")
PLAN = Plan(height=1.5, settle=0.3, origin="takeoff", speed=2.0, acceleration=3.0)


def link_drawn(number: int) -> dict[str, Any]:
    """A flight by its number."""
    random = np.random.default_rng((LINK_FIRST_SEED, number))
    return {
        "key": f"lockstep {number}",
        "seed": LINK_FIRST_SEED + number,
        "vehicle": str(random.choice(VEHICLES)),
        "reference": str(random.choice(LINK_MANOEUVRES)),
        "message": MESSAGES[number % 2],
        "estimator": ESTIMATORS[number // 2 % 2],
        "rotor": int(random.integers(4)),
        "loss": LOSS if number % 3 else 0.0,
    }


def link_flown(case: Mapping[str, Any]) -> dict[str, Any]:
    """Named effects, s after it happened."""
    file = FOLDER / f"{case['vehicle']}.toml"
    vehicle = read_vehicle(file)
    options = ControllerOptions.for_vehicle(vehicle, period=CONTROL_PERIOD, adaptation=ON)
    controller = Controller.build(vehicle, options)
    use = EffectUse("weak_rotor", {"loss": 0.0, "torque_loss": 0.0}, case["rotor"])
    fault = Fault(kind="effect", at=AFTER_TAKE_OFF, after="takeoff", values={f"{use.label}.loss": case["loss"]})
    began: list[float] = []

    def watch(flight: Any) -> None:
        if not began and not flight.autopilot.commander.landed:
            began.append(flight.autopilot.time + AFTER_TAKE_OFF)

    flight = fly_whole(
        MockOptions(
            file, scenario=Scenario(effects=(use,), estimator=case["estimator"], faults=(fault,)), seed=case["seed"]
        ),
        named_reference(case["reference"], vehicle, duration=LINK_SECONDS),
        plan=PLAN,
        controllers=Controllers(controller),
        watch=watch,
        rotors=case["message"],
    )
    assert controller.adaptation is not None
    assert controller.adaptation.rotors is not None
    times = flight.times(Event.ROTOR_WEAK)
    return {
        **case,
        "after": times[0] - began[0] if times else None,
        "named": [[loss.rotor, loss.share, loss.deviation] for loss in controller.adaptation.rotors.losses],
        "outcome": flight.outcome,
        "landing_reason": flight.landing_reason,
    }


def flown_over_udp(case: Mapping[str, Any]) -> dict[str, Any]:
    """Named effects by the daemon, in real time over MAVLink; the autopilot sends both messages."""
    file = FOLDER / f"{case['vehicle']}.toml"
    vehicle = read_vehicle(file)
    with tempfile.TemporaryDirectory() as folder:
        scenario = Path(folder) / "scenario.toml"
        scenario.write_text(
            f'estimator = "{case["estimator"]}"\n'
            f'[[effects]]\nname = "weak_rotor"\nrotor = {case["rotor"]}\n'
            "parameters = {loss = 0.0, torque_loss = 0.0}\n"
            f'[[faults]]\nkind = "effect"\nat = {AFTER_TAKE_OFF}\nafter = "takeoff"\n'
            f'values = {{"weak_rotor[{case["rotor"]}].loss" = {case["loss"]}}}\n'
        )
        reference = named_reference(case["reference"], vehicle, duration=LINK_SECONDS)
        with mock_process("--scenario", str(scenario), vehicle=file) as mock:
            request = FlightRequest(
                endpoint=parse_endpoint(mock.url), plan=PLAN, record=Path(folder), name="flight", adaptation=ON
            )
            report = Daemon(request, vehicle, reference, print).fly()
        recording = read_recording(Path(folder) / "flight.mcap")
    followed = {} if report.followed is None else report.followed.parameters
    named = [[int(k[11]), v.value, v.std] for k, v in followed.items() if k.startswith("weak_rotor[")]
    counts = {topic: len(recording.messages.get(topic, ())) for topic in ("/rotors", "/motors")}
    return {**case, "after": None, "named": named, "outcome": report.outcome, "recorded": counts}


def link_table(results: Sequence[Mapping[str, Any]]) -> str:
    """By message and estimator."""
    body = [
        f"A rotor of {', '.join(VEHICLES)} loses {LOSS:.0%} of its thrust {AFTER_TAKE_OFF:g} s after take-off; in "
        "every third flight none does. Rotor speeds are those of the messages of the mock's autopilot.",
        "",
        "| message | estimates | losses | named right | wrong | s until named, median (worst) | interval holds | "
        "none lost | named |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    lockstep = [r for r in results if r["key"].startswith("lockstep")]
    for message in MESSAGES:
        for estimator in ESTIMATORS:
            some = [r for r in lockstep if (r["message"], r["estimator"]) == (message, estimator)]
            body.append(f"| {message} | {estimator} | {' | '.join(_cells(some))} |")
    ended = [f"{r['key']}: {r['landing_reason'] or r['outcome']}" for r in lockstep if r["landing_reason"]]
    body += ["", f"Flights cut short: {'; '.join(ended) or 'none'}."]
    body += ["", "In real time, by the daemon over UDP:", ""]
    body += ["| vehicle | reference | estimates | rotor | named | recorded |", "| --- | --- | --- | --- | --- | --- |"]
    for r in results:
        if not r["key"].startswith("lockstep"):
            named = ", ".join(f"{rotor}: {share:.3f} +- {1.96 * std:.3f}" for rotor, share, std in r["named"]) or "none"
            counts = ", ".join(f"{count} {topic}" for topic, count in r["recorded"].items())
            body.append(f"| {r['vehicle']} | {r['reference']} | {r['estimator']} | {r['rotor']} | {named} | {counts} |")
    return "\n".join(body)


def _cells(some: Sequence[Mapping[str, Any]]) -> list[str]:
    losses = [r for r in some if r["loss"]]
    right = [r for r in losses if r["named"] and r["named"][0][0] == r["rotor"]]
    wrong = sum(any(named[0] != r["rotor"] for named in r["named"]) for r in losses)
    times = [r["after"] for r in right if r["after"] is not None]
    holds = sum(abs(r["named"][0][1] - LOSS) <= 1.96 * r["named"][0][2] for r in right)
    none = [r for r in some if not r["loss"]]
    when = f"{np.median(times):.1f} ({max(times):.1f})" if times else ""
    return [
        f"{len(losses)}",
        f"{len(right)}",
        f"{wrong}",
        when,
        f"{holds}",
        f"{len(none)}",
        f"{sum(bool(r['named']) for r in none)}",
    ]


def link(words: Sequence[str]) -> Page:
    """Rotors that lose thrust, told from what an autopilot's messages bring of them. Writes results/rotor_loss_link.md.

    Flights from ground to ground in lockstep, with ESC_STATUS or SERVO_OUTPUT_RAW encoded and decoded, and the
    estimates of a motion capture or of PX4's estimator, drawn by the seed; a third of them with no loss. Then some in
    real time, by the daemon over UDP. Finished flights are kept, so that a run that was stopped resumes.

        python -m benchmarks rotor_loss link --flights 72 --udp 4
    """
    parser = options_of(link.__doc__, resumes="rotor_loss_link", jobs=1, flights=72)
    parser.add_argument("--udp", type=int, default=4, help="flights in real time, 45 s each")
    options = parser.parse_args(words)
    key_of = itemgetter("key")
    results = measured(
        link_flown, [link_drawn(number) for number in range(options.flights)], options, spoken, key_of=key_of
    )
    real = [
        {**link_drawn(1000 + n), "key": f"udp {n}", "loss": LOSS, "vehicle": VEHICLES[n % 2]}
        for n in range(options.udp)
    ]
    options.jobs = 1  # in real time
    results += measured(flown_over_udp, real, options, spoken, key_of=key_of)
    return Page("rotor_loss_link", "A rotor that loses thrust, by an autopilot's messages", link_table(results))
