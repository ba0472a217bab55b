"""Rotors that lose thrust, told from what an autopilot's messages bring of them. Writes results/rotor_loss_link.md.

Flights from ground to ground in lockstep, with ESC_STATUS or SERVO_OUTPUT_RAW encoded and decoded, and the estimates of
a motion capture or of PX4's estimator, drawn by the seed; a third of them with no loss. Then some in real time, by the
daemon over UDP. Finished flights are kept, so that a run that was stopped resumes.

    python -m benchmarks.rotor_loss_link --flights 72 --udp 4 --table
"""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.resumable import measured, options_of, publish
from dynamics.controller_settings import CONTROL_PERIOD
from dynamics.references import named_reference
from dynamics.vehicle import EffectUse
from dynamics.vehicle_file import read_vehicle
from runtime.control.adaptation_settings import AdaptationSettings
from runtime.control.controller import Controller, ControllerOptions
from runtime.daemon import Daemon
from runtime.flight.composition import Controllers
from runtime.flight.events import Event
from runtime.flight.mission import Plan
from runtime.flight_request import FlightRequest
from runtime.link.connection import parse_endpoint
from runtime.record.recording import read_recording
from simulation.mock_process import mock_process
from simulation.whole_flight import fly_whole
from sitl_mock.autopilot.fault_schedule import Fault
from sitl_mock.mock import MockOptions
from sitl_mock.scenario import Scenario
from vehicles import FOLDER

VEHICLES = ("arpl_250g", "px4_sih", "crazyflie")
MANOEUVRES = ("Hover", "circle", "line", "Ellipse_1", "WarpedEllipse_1", "Lemniscate")
MESSAGES = ("ESC_STATUS", "SERVO_OUTPUT_RAW")
ESTIMATORS = ("mocap", "px4")
LOSS, AFTER_TAKE_OFF, SECONDS = 0.15, 9.0, 14.0
FIRST_SEED = 58_000
ON = AdaptationSettings(mode="on")
PLAN = Plan(height=1.5, settle=0.3, origin="takeoff", speed=2.0, acceleration=3.0)


def drawn(number: int) -> dict[str, Any]:
    """A flight by its number."""
    random = np.random.default_rng((FIRST_SEED, number))
    return {
        "key": f"lockstep {number}",
        "seed": FIRST_SEED + number,
        "vehicle": str(random.choice(VEHICLES)),
        "reference": str(random.choice(MANOEUVRES)),
        "message": MESSAGES[number % 2],
        "estimator": ESTIMATORS[number // 2 % 2],
        "rotor": int(random.integers(4)),
        "loss": LOSS if number % 3 else 0.0,
    }


def flown(case: Mapping[str, Any]) -> dict[str, Any]:
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
        named_reference(case["reference"], vehicle, duration=SECONDS),
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
        reference = named_reference(case["reference"], vehicle, duration=SECONDS)
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


def table(results: Sequence[Mapping[str, Any]]) -> str:
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


def main() -> None:
    """Fly what has not been flown, and write the table."""
    parser = options_of(__doc__, "rotor_loss_link", flights=72)
    parser.add_argument("--udp", type=int, default=4, help="flights in real time, 45 s each")
    options = parser.parse_args()
    key_of = itemgetter("key")
    results = measured(flown, [drawn(number) for number in range(options.flights)], options, spoken, key_of=key_of)
    real = [
        {**drawn(1000 + n), "key": f"udp {n}", "loss": LOSS, "vehicle": VEHICLES[n % 2]} for n in range(options.udp)
    ]
    options.jobs = 1  # in real time
    results += measured(flown_over_udp, real, options, spoken, key_of=key_of)
    publish("rotor_loss_link", "A rotor that loses thrust, by an autopilot's messages", table(results), options)


def spoken(result: Mapping[str, Any]) -> str:
    """A line about a flight."""
    return f"{result['key']} {result['vehicle']} {result['reference']}: {result['named']}"


if __name__ == "__main__":
    main()
