"""The mock from its options: the autopilot with its vehicle, its links, and the process around them."""

from __future__ import annotations

import math
import signal
import time
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType
from typing import TypeVar

import msgspec
import numpy as np

from dynamics.errors import RequestError
from dynamics.own_effects import catalogue_of
from dynamics.rate_loop import autopilot_gains
from dynamics.signing_key import read_signing_key, signing_ticks
from dynamics.vehicle import Vehicle
from dynamics.vehicle_file import parse_effect, read_vehicle
from sitl_mock.autopilot.autopilot import Autopilot, Behaviour
from sitl_mock.autopilot.offboard import Rule
from sitl_mock.autopilot.parameters import Parameters
from sitl_mock.scenario import Scenario, read_scenario
from sitl_mock.server import Pace, Server, Wire
from sitl_mock.vehicle.clock import SITL_TICK, ClockKind, UnevenTime
from sitl_mock.vehicle.estimator import Estimator
from sitl_mock.vehicle.ground import GroundKind
from sitl_mock.vehicle.tuning import default_tuning, parameter_values
from sitl_mock.vehicle.vehicle import SimulatedVehicle
from sitl_mock.wire.link_spec import LinkSpec, default_links
from sitl_mock.wire.snapshot import motor_order

AnyStruct = TypeVar("AnyStruct", bound=msgspec.Struct)
PX4_SIMULATED = ("px4_sih",)  # names of vehicles that fly in PX4's own simulation


@dataclass(frozen=True, slots=True)
class Surroundings:
    """Surroundings of a vehicle where neither options nor scenario say so."""

    estimator: Estimator
    ground: GroundKind
    clock: ClockKind


IN_PX4S_SIMULATION = Surroundings("px4", "sih", "sitl")
IN_MOTION_CAPTURE = Surroundings("mocap", "legs", "steady")


@dataclass(frozen=True, slots=True)
class MockOptions:
    """All options of a mock.

    vehicle: the vehicle file.
    effects: hidden effects as on the command line, `name:key=value,...`.
    tuned_for: the vehicle file whose gains the autopilot's rate loop has; None for those of the flown one.
    scenario: or its file.
    estimator: whose errors the estimate has; None for the scenario's or the one that suits the vehicle.
    start_height_error: of the estimate, m; None for the scenario's or one by chance.
    ground: its kind; None for the scenario's or the one that suits the vehicle.
    slope: of the ground, degrees; None for the scenario's.
    seed: of all randomness.
    double_ack, rule, body_velocity: see `Behaviour`.
    clock: how time runs; None for the scenario's or the one that suits the vehicle.
    clock_drift: see `Behaviour`; None for the scenario's.
    parameters: PX4 parameters by name.
    instance: PX4's, added to ports and to the system id.
    signing_key: key file of MAVLink signing, None for an autopilot that does not sign until it is given a key. The
        file's date is that of the key's set-up, whose timestamp PX4 begins with after every start.
    epoch: unix time at boot, s; None for now.
    """

    vehicle: Path
    effects: tuple[str, ...] = ()
    effect_files: tuple[Path, ...] = ()
    tuned_for: Path | None = None
    scenario: Path | Scenario | None = None
    estimator: Estimator | None = None
    start_height_error: float | None = None
    ground: GroundKind | None = None
    slope: float | None = None
    seed: int = 0
    double_ack: bool = False
    rule: Rule = "measured"
    body_velocity: bool = False
    clock: ClockKind | None = None
    clock_drift: float | None = None
    parameters: dict[str, float] = field(default_factory=dict)
    instance: int = 0
    signing_key: Path | None = None
    epoch: float | None = None


def _geometry(vehicle: Vehicle) -> dict[str, float]:
    """PX4's parameters of its motors' places, forward and to the right, m."""
    order = motor_order(np.array(vehicle.rotors.position))
    places = [vehicle.rotors.position[rotor] for rotor in order]
    named = {f"CA_ROTOR{motor}_PX": x for motor, (x, _, _) in enumerate(places)}
    named |= {f"CA_ROTOR{motor}_PY": -y for motor, (_, y, _) in enumerate(places)}
    return {"CA_ROTOR_COUNT": vehicle.rotors.count, **named}


def build_autopilot(options: MockOptions) -> Autopilot:
    """An autopilot on the ground at simulated time 0, without links.

    Raises RequestError for a vehicle, effect, scenario or parameter that is not valid.
    """
    vehicle, scenario = _plan(options)
    catalogue = catalogue_of(vehicle)
    requested = tuple(parse_effect(text, vehicle.rotors.count, catalogue=catalogue) for text in options.effects)
    hidden = (*scenario.hidden_effects(), *requested)
    tuning = default_tuning(_tuned(vehicle, options.tuned_for), hidden, catalogue)
    defaults = {**parameter_values(tuning), "MAV_SYS_ID": options.instance + 1, **_geometry(vehicle)}
    simulated = SimulatedVehicle(
        vehicle,
        effects=hidden,
        options=scenario.vehicle_options(),
        tuning=tuning,
        seed=options.seed,
        catalogue=catalogue,
    )
    for fault in scenario.faults:
        simulated.require(fault.values)
    behaviour = Behaviour(
        rule=options.rule,
        double_ack=options.double_ack,
        body_velocity=options.body_velocity,
        clock_drift=scenario.clock.drift,
        clock_tick=SITL_TICK if scenario.clock.kind == "sitl" else 0.0,
        epoch=time.time() if options.epoch is None else options.epoch,
        faults=scenario.faults,
        seed=options.seed,
    )
    autopilot = Autopilot(simulated, Parameters({**defaults, **scenario.parameters, **options.parameters}), behaviour)
    if options.signing_key is not None:
        secret = read_signing_key(options.signing_key).secret
        autopilot.signing.set_key(secret, signing_ticks(options.signing_key.stat().st_mtime))
    return autopilot


def _tuned(vehicle: Vehicle, other: Path | None) -> Vehicle:
    """The vehicle with the gains of another file, if there is one."""
    if other is None:
        return vehicle
    return msgspec.structs.replace(vehicle, autopilot=autopilot_gains(read_vehicle(other)))


def usual_surroundings(vehicle: Vehicle) -> Surroundings:
    """Surroundings that suit a vehicle: PX4's own simulation for its quadrotor, motion capture for all others."""
    return IN_PX4S_SIMULATION if vehicle.name in PX4_SIMULATED else IN_MOTION_CAPTURE


def _plan(options: MockOptions) -> tuple[Vehicle, Scenario]:
    """The vehicle, and the scenario with what the options decide otherwise and nothing left open."""
    vehicle = read_vehicle(options.vehicle, effect_files=options.effect_files)
    scenario = options.scenario or Scenario()
    if isinstance(scenario, Path):
        scenario = read_scenario(scenario, vehicle.rotors.count, catalogue=catalogue_of(vehicle))
    usual = usual_surroundings(vehicle)
    ground = {"kind": options.ground or scenario.ground.kind or usual.ground}
    clock = {"kind": options.clock or scenario.clock.kind or usual.clock}
    slope = None if options.slope is None else math.radians(options.slope)
    return vehicle, _replaced(
        scenario,
        estimator=options.estimator or scenario.estimator or usual.estimator,
        start_height_error=options.start_height_error,
        ground=_replaced(scenario.ground, **ground, slope=slope),
        clock=_replaced(scenario.clock, **clock, drift=options.clock_drift),
    )


def _replaced(struct: AnyStruct, **fields: object) -> AnyStruct:
    """A struct with the fields that are not None in place of its own. Raises RequestError as the struct does."""
    return msgspec.structs.replace(struct, **{name: value for name, value in fields.items() if value is not None})


def parse_parameter(text: str) -> tuple[str, float]:
    """A parameter of a command line, NAME=VALUE. Raises RequestError for any other text."""
    name, _, value = text.partition("=")
    try:
        return name.strip(), float(value)
    except ValueError:
        raise RequestError(f"parameter {text!r}: wanted NAME=NUMBER, such as COM_OF_LOSS_T=0.5.") from None


def serve(
    options: MockOptions, links: list[LinkSpec] | None = None, *, pace: Pace = "realtime", speed: float = 1.0
) -> Server:
    """Run a mock on its links (PX4's two by default) until SIGINT or SIGTERM; returns the server that ran.

    Raises RequestError for options that are not valid, a port in use or a device that cannot be opened.
    """
    if not 0.01 <= speed <= 100.0:
        raise RequestError(f"speed {speed}: wanted 0.01 to 100 times real time.")
    specs = default_links(options.instance) if links is None else links
    autopilot = build_autopilot(options)
    uneven = UnevenTime(options.seed) if _plan(options)[1].clock.kind == "sitl" else None
    wires: list[Wire] = []
    try:
        wires.extend(Wire(autopilot.add_link(spec.name, spec.role), spec.open()) for spec in specs)
    except RequestError:
        for wire in wires:
            wire.transport.close()
        raise
    server = Server(autopilot, wires, pace=pace, speed=speed, uneven=uneven)
    stop = _stop_on_signals()
    server.run(stop)
    return server


class _Stop:
    """Whether a signal has requested the end of the process."""

    def __init__(self) -> None:
        self.requested = False

    def __call__(self) -> bool:
        return self.requested

    def request(self, _number: int, _frame: FrameType | None) -> None:
        self.requested = True


def _stop_on_signals() -> _Stop:
    stop = _Stop()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, stop.request)
    return stop
