"""`alula mock`: the mock flight controller as a process of its own."""

from __future__ import annotations

import os
import signal
import sys
import threading
from pathlib import Path
from typing import Annotated

import typer

from alula.cli.options import Effects
from alula.cli.output import command
from alula.workbench import require_casadi
from dynamics.vehicle_file import find_vehicle
from sitl_mock.autopilot.offboard import Rule
from sitl_mock.mock import MockOptions, parse_parameter, serve
from sitl_mock.server import Pace
from sitl_mock.vehicle.clock import ClockKind
from sitl_mock.vehicle.estimator import Estimator
from sitl_mock.vehicle.ground import GroundKind
from sitl_mock.wire.link_spec import LinkSpec, default_links, parse_link


def mock(
    vehicle: Annotated[str, typer.Option(help="Vehicle file (TOML), or the name of a bundled one.")],
    effect: Annotated[
        list[str] | None,
        typer.Option(help="Effect that the vehicle file does not contain: name:key=value,... Repeatable."),
    ] = None,
    effects: Effects = None,
    tuned_for: Annotated[
        str | None,
        typer.Option(
            help="Vehicle file (or bundled name) that the autopilot's rate gains suit, where it was not tuned again "
            "for the flown one: an autopilot keeps its gains when a model is corrected."
        ),
    ] = None,
    scenario: Annotated[Path | None, typer.Option(help="Scenario file (TOML): sensors, battery, timed faults.")] = None,
    link: Annotated[
        list[str] | None,
        typer.Option(
            help="Companion's link instead of PX4's own two (14580 to 14540, 18570 to 14550): udpout:HOST:PORT, "
            "udpin:HOST:PORT, tcp:HOST:PORT, tcpin:HOST:PORT, serial:DEVICE:BAUD. Repeatable."
        ),
    ] = None,
    gcs_link: Annotated[list[str] | None, typer.Option(help="Ground station's link, as --link. Repeatable.")] = None,
    estimator: Annotated[
        Estimator | None,
        typer.Option(
            help="Errors of the estimate: px4 (as of its EKF on GNSS: decimetres, and the height at the start), mocap "
            "(millimetres) or perfect; px4 by default for px4_sih, otherwise mocap."
        ),
    ] = None,
    start_height_error: Annotated[
        float | None, typer.Option(help="The estimate's error in height at the start, m; random by default.")
    ] = None,
    ground: Annotated[
        GroundKind | None,
        typer.Option(
            help="legs (under legs and hull, rough) or sih (as PX4's own simulation: no moment rights the vehicle); "
            "sih by default for px4_sih, otherwise legs."
        ),
    ] = None,
    slope: Annotated[float | None, typer.Option(help="Slope of the ground, degrees.")] = None,
    instance: Annotated[int, typer.Option(min=0, max=249, help="PX4's instance: added to ports and system id.")] = 0,
    seed: Annotated[int, typer.Option(help="Seed of all randomness.")] = 0,
    lockstep: Annotated[
        bool, typer.Option("--lockstep/--realtime", help="Advance to the next estimate with every setpoint.")
    ] = False,
    speed: Annotated[float, typer.Option(help="Simulated seconds per second.")] = 1.0,
    double_ack: Annotated[
        bool, typer.Option(help="Answer DO_SET_MODE twice, as PX4 of July 2025 to May 2026.")
    ] = False,
    offboard_rule: Annotated[
        Rule,
        typer.Option(
            help="When OFFBOARD may begin: measured (after one setpoint, as PX4 does) or documented (2 Hz for 1 s)."
        ),
    ] = "measured",
    body_velocity: Annotated[bool, typer.Option(help="ODOMETRY's velocity in BODY_FRD instead of NED.")] = False,
    clock: Annotated[
        ClockKind | None,
        typer.Option(
            help="steady, or sitl: as PX4's own simulation runs against the clock, 11 ms per second slow and in steps "
            "of 5 to 18 ms, with stamps in steps of 4 ms; sitl by default for px4_sih, otherwise steady."
        ),
    ] = None,
    clock_drift: Annotated[
        float | None,
        typer.Option(help="Seconds that the vehicle's clock gains per second of flight; 0.00002 by default."),
    ] = None,
    param: Annotated[list[str] | None, typer.Option(help="PX4 parameter NAME=VALUE. Repeatable.")] = None,
    signing_key: Annotated[
        Path | None,
        typer.Option(
            help="Key file (mode 600) of MAVLink 2 signing, as PX4 has it on its SD card; its date is that of the "
            "key's set-up. Without it the mock signs once it is given a key (alula link --setup-signing).",
            metavar="FILE",
        ),
    ] = None,
    end_with_input: Annotated[
        bool, typer.Option("--end-with-input", help="End when standard input does, as when its program was killed.")
    ] = False,
) -> None:
    """Fly a simulated vehicle behind PX4's side of the link, until interrupted."""
    require_casadi("alula mock")
    options = MockOptions(
        vehicle=find_vehicle(vehicle),
        effects=tuple(effect or ()),
        effect_files=tuple(effects or ()),
        tuned_for=None if tuned_for is None else find_vehicle(tuned_for),
        scenario=scenario,
        estimator=estimator,
        start_height_error=start_height_error,
        ground=ground,
        slope=slope,
        seed=seed,
        double_ack=double_ack,
        rule=offboard_rule,
        body_velocity=body_velocity,
        clock=clock,
        clock_drift=clock_drift,
        parameters=dict(parse_parameter(text) for text in param or ()),
        instance=instance,
        signing_key=signing_key,
    )
    if end_with_input:
        threading.Thread(target=_end_with_input, name="input", daemon=True).start()
    links = _links(link or [], gcs_link or [], instance)
    pace: Pace = "lockstep" if lockstep else "realtime"
    print(f"mock of {vehicle} on {', '.join(spec.name for spec in links)}; Ctrl-C ends it", file=sys.stderr, flush=True)
    if not link:
        following = command("fly", "--vehicle", vehicle, "--reference", "hover", "--record", "recordings")
        print(f"next, in another terminal: {following}", file=sys.stderr, flush=True)
    server = serve(options, links, pace=pace, speed=speed)
    if server.slipped > 1.0:
        print(f"this machine was too slow, by {server.slipped:.1f} s of simulated time", file=sys.stderr)


def _end_with_input() -> None:
    while os.read(sys.stdin.fileno(), 4096):
        pass
    os.kill(os.getpid(), signal.SIGTERM)


def _links(onboard: list[str], gcs: list[str], instance: int) -> list[LinkSpec]:
    if not onboard and not gcs:
        return default_links(instance)
    return [parse_link(text, "onboard", instance) for text in onboard] + [
        parse_link(text, "gcs", instance) for text in gcs
    ]
