"""Flights in lockstep: the runtime's own logic on the mock's vehicle in one process, in simulated time, without a link.

The mock's autopilot climbs to the reference's start, the flyer engages in the air, as it does for a pilot, and tracks
the reference. Same inputs, same bits.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import msgspec
import numpy as np

from dynamics.arrays import Floats
from dynamics.controller_settings import CONTROL_PERIOD
from dynamics.effect import Effect
from dynamics.effects import CATALOGUE
from dynamics.errors import VehicleError
from dynamics.references import Reference
from dynamics.state import POSITION, RATE, RIGID_BODY_STATES
from dynamics.vehicle import EffectUse, Vehicle
from flights.log import Log, Provenance, Stream
from runtime.control.controller import Controller, ControllerOptions
from runtime.flight.composition import Controllers, build_flyer
from runtime.flight.decision import Decision, FlyerSettings
from runtime.flight.engagement import EngagementSettings
from runtime.flight.events import Fallback
from runtime.flight.flyer import Flyer
from runtime.flight.health import HealthLimits
from runtime.flight.mission import Plan
from runtime.flight.phases import Phase
from runtime.followed_record import followed_record
from runtime.link.estimate import StateEstimate
from runtime.record.records import FollowedRecord, ObservationRecord
from sitl_mock.vehicle.tuning import rate_gains
from sitl_mock.vehicle.vehicle import SimulatedVehicle, VehicleOptions
from sitl_mock.vehicle.vehicle_interface import ControlSetpoint, Tuning

LATENCY = 0.005  # s from an estimate to the setpoint that follows from it, as over a link
CLIMB_TIME, CLIMB_PATIENCE = 2.0, 120.0  # s; in gusts an autopilot arrives by chance
ARRIVED = 0.15  # m and m/s
TAKE_OVER_PATIENCE = 20.0  # s
FOLLOWED_EVERY = 10  # ticks


@dataclass(frozen=True)
class ParameterStep:
    """Constants of the vehicle that change in flight.

    time: s since the reference's start.
    values: by name, such as {"weak_rotor[2].loss": 0.15}, of hidden effects that are there from the start.
    """

    time: float
    values: Mapping[str, float]


@dataclass
class FlightRows:
    """A flight's data, row by row. Stamps are s since the reference's start.

    away: whether a fallback flew instead of the controller's own model.
    followed: what the model followed, ten times a second.
    effectiveness: of the thrust, per modelled thrust.
    """

    estimate: list[tuple[float, Floats]] = field(default_factory=list)
    imu: list[tuple[float, Floats]] = field(default_factory=list)
    motors: list[tuple[float, Floats]] = field(default_factory=list)
    speed: list[tuple[float, Floats]] = field(default_factory=list)
    setpoint: list[tuple[float, Floats]] = field(default_factory=list)
    truth: list[tuple[float, Floats]] = field(default_factory=list)
    away: list[bool] = field(default_factory=list)
    followed: list[FollowedRecord] = field(default_factory=list)
    effectiveness: list[float] = field(default_factory=list)


@dataclass(frozen=True, eq=False)
class FlownReference:
    """A tracked reference.

    log: the vehicle's log.
    truth: ground truth.
    aborted: why it ended early.
    fallbacks: number of fallbacks from the controller's own model.
    fallback_seconds: their duration in all.
    events: how often each was raised in the whole flight.
    followed: what the model followed, ten times a second; empty where it did not.
    effectiveness: (n,) thrust per modelled thrust, at each setpoint.
    """

    log: Log
    truth: Log
    aborted: str
    fallbacks: int = 0
    fallback_seconds: float = 0.0
    events: Mapping[str, int] = field(default_factory=dict)
    followed: Sequence[FollowedRecord] = ()
    effectiveness: Sequence[float] = ()

    @property
    def seconds(self) -> float:
        """How long the reference was tracked, s."""
        return float(self.truth.streams[0].time[-1]) if self.truth.streams else 0.0

    @property
    def position_rmse(self) -> float:
        """Of the true position while the reference was tracked, m; NaN without any."""
        true, setpoint = self.truth.stream("position"), self.log.stream("position_setpoint")
        if true is None or setpoint is None:
            return float("nan")
        return float(np.sqrt(np.mean(np.sum((true.values - setpoint.values) ** 2, axis=1))))


def fly_reference(
    vehicle: Vehicle,
    reference: Reference,
    *,
    effects: Sequence[EffectUse] = (),
    options: VehicleOptions | None = None,
    seed: int = 0,
    name: str = "",
    controller: Controller | None = None,
    nominal: Controller | None = None,
    catalogue: Mapping[str, Effect] = CATALOGUE,
    steps: Sequence[ParameterStep] = (),
    tuning: Tuning | None = None,
) -> FlownReference:
    """Fly a reference from its start to its end.

    effects: hidden from the controller.
    steps: of the vehicle in flight.
    options: the vehicle's sensors.
    controller: None for one of the vehicle file alone, which knows the autopilot's gains, as over a link.
    tuning: of the autopilot; None for the vehicle file's, else what suits the vehicle as it is.
    nominal: the fallback of a learned model's controller.

    Raises VehicleError when the vehicle does not reach the reference's start.
    """
    start = reference.states(np.zeros(1))[0]
    yaw = float(2 * np.arctan2(start[9], start[6]))
    options = options or VehicleOptions(yaw=yaw)
    plant = SimulatedVehicle(vehicle, effects=effects, options=options, tuning=tuning, seed=seed, catalogue=catalogue)
    _climb(plant, start[POSITION], yaw)
    if controller is None:
        gains = rate_gains(plant.tuning)
        choice = ControllerOptions.for_vehicle(vehicle, period=CONTROL_PERIOD, gains=gains, catalogue=catalogue)
        controller = Controller.build(vehicle, choice, catalogue)
    health = HealthLimits.for_vehicle(vehicle, catalogue)
    settings = FlyerSettings(period=CONTROL_PERIOD, engagement=EngagementSettings(resume=True), health=health)
    flyer = build_flyer(
        Controllers(controller, nominal), reference, Plan(), settings, thrust_curve=plant.tuning.thrust_model_factor
    )
    hold = ControlSetpoint("hold", position_world=start[POSITION], yaw=yaw)
    rows, aborted = _track(plant, flyer, hold, steps)
    fallbacks = sum(now and not before for before, now in zip([False, *rows.away], rows.away, strict=False))
    events = {event.value: count for event, count in flyer.events.counts.items() if count}
    seconds_away = CONTROL_PERIOD * sum(rows.away)
    log, truth = _log(rows, name), _truth(rows, name)
    estimated = tuple(rows.followed), tuple(rows.effectiveness)
    return FlownReference(log, truth, aborted, fallbacks, seconds_away, events, *estimated)


def _climb(plant: SimulatedVehicle, place: Floats, yaw: float) -> None:
    """Let the autopilot fly to a place and hold there."""
    target = ControlSetpoint("hold", position_world=place, yaw=yaw)
    for _ in range(round(CLIMB_PATIENCE / CLIMB_TIME)):
        plant.advance(target, True, CLIMB_TIME)
        away = np.linalg.norm(plant.truth.position_world - place)
        if away < ARRIVED and np.linalg.norm(plant.truth.velocity_world) < ARRIVED:
            return
    raise VehicleError(
        f"the vehicle did not reach {np.round(place, 2).tolist()} m, where the reference begins, within "
        f"{CLIMB_PATIENCE:g} s: the hidden effects are too strong for its autopilot."
    )


def _track(
    plant: SimulatedVehicle, flyer: Flyer, hold: ControlSetpoint, steps: Sequence[ParameterStep]
) -> tuple[FlightRows, str]:
    rows, setpoint = FlightRows(), hold
    due = sorted(steps, key=lambda step: step.time)
    began = plant.time
    tick = 0
    while True:
        now = round(1000 * plant.time) / 1000  # whole milliseconds: stamps of equal instants have equal bits
        decision = _decide(plant, flyer, tick, now)
        if flyer.engagement.flying and decision.rate_body is not None:
            following = ControlSetpoint("rates", rate_body=decision.rate_body, thrust=decision.thrust)
        else:
            following = hold
        phase = flyer.mission.phase
        tracking = phase is Phase.TRACK
        since = now - flyer.mission.phase_started
        if tracking:
            while due and since >= due[0].time:
                plant.change(due.pop(0).values)
            _keep(rows, plant, since, following, flyer.reference_now(now))
            rows.away.append(decision.fallback is not Fallback.NONE)
            rows.effectiveness.append(flyer.effectiveness.value)
            if tick % FOLLOWED_EVERY == 0 and (followed := followed_record(flyer, since)) is not None:
                rows.followed.append(followed)
        reason = flyer.mission.landing_reason or (flyer.engagement.refusal if flyer.over else "")
        if reason or phase is Phase.RETURN:
            return rows, reason
        if not rows.truth and plant.time - began > TAKE_OVER_PATIENCE:
            return rows, "the flyer did not take over"
        _advance(plant, setpoint, following, rows if tracking else None, since)
        setpoint, tick = following, tick + 1


def quiet_observation(tick: int, now: float, **more: Any) -> ObservationRecord:
    """Observation of an armed vehicle in offboard mode that reports nothing else; more: fields that differ."""
    usual = ObservationRecord(
        tick=tick,
        time=now,
        estimate_arrival=now,
        connected=True,
        armed=True,
        offboard=True,
        mode="OFFBOARD",
        landed=False,
        findings="",
        reset=False,
        reset_position=np.zeros(3),
        reset_yaw=0.0,
        specific_force_z=float("nan"),
        engage=False,
        leave="",
    )
    return msgspec.structs.replace(usual, **more)


def _decide(plant: SimulatedVehicle, flyer: Flyer, tick: int, now: float) -> Decision:
    estimated = plant.estimate
    parts = [estimated.position_world, estimated.velocity_world, estimated.attitude, estimated.rate_body]
    state = np.concatenate(parts)
    estimate = StateEstimate(round(1000 * estimated.time) / 1000, now, state, 0, True, "ODOMETRY")
    observation = quiet_observation(
        tick,
        now,
        landed=plant.on_ground,
        specific_force_z=float(plant.imu.specific_force_body[2]),
        specific_force_xy=np.array(plant.imu.specific_force_body[:2]),
        engage=tick == 0,
        rotor_time=now,
        rotor_speed=plant.rotor_speed,
        rotors_measured=True,
        battery_voltage=plant.battery.voltage,
    )
    decision = flyer.step(observation, estimate)
    flyer.prepare(now)
    return decision


def _advance(
    plant: SimulatedVehicle, before: ControlSetpoint, after: ControlSetpoint, rows: FlightRows | None, since: float
) -> None:
    """One period, with inertial and rotor speed samples whose middle is the period's start.

    Rotor speeds ripple with the period of the setpoints, which is the log's: at an instant of each period they would
    be a percent off their mean wherever the vehicle turns.
    """
    half = round(plant.options.sensors.imu_average / 2, 3)
    first = min(half, LATENCY)
    plant.advance(before, True, first)
    if rows is not None:
        sample = plant.imu
        rows.imu.append((since, np.concatenate([sample.specific_force_body, sample.rate_body])))
    plant.advance(before, True, LATENCY - first)
    if rows is not None:
        rows.speed.append((since, plant.mean_rotor_speed(2 * LATENCY)))
    plant.advance(after, True, CONTROL_PERIOD - LATENCY)


def _keep(
    rows: FlightRows, plant: SimulatedVehicle, since: float, setpoint: ControlSetpoint, reference: Floats | None
) -> None:
    true, estimated = plant.truth, plant.estimate
    age = round(1000 * (plant.time - estimated.time)) / 1000
    pose = [estimated.position_world, estimated.velocity_world, estimated.attitude]
    rows.estimate.append((since - age, np.concatenate(pose)))
    rows.motors.append((since, np.append(plant.motor_signal, plant.battery.voltage)))
    tracked = np.full(RIGID_BODY_STATES, np.nan) if reference is None else reference
    rows.setpoint.append((since, np.concatenate([tracked[: RATE.start], setpoint.rate_body, [setpoint.thrust]])))
    motion = [true.position_world, true.velocity_world, true.attitude, true.rate_body, plant.true_rotor_speed]
    rows.truth.append((since, np.concatenate(motion)))


def _log(rows: FlightRows, name: str) -> Log:
    motors = len(rows.motors[0][1]) - 1 if rows.motors else 0
    streams = [
        *_streams(rows.estimate, "estimate", position=(0, 3), velocity=(3, 6), attitude=(6, 10)),
        *_streams(rows.imu, "imu", rate=(3, 6), specific_force=(0, 3)),
        *_streams(rows.speed, "motors", rotor_speed=(0, motors)),
        *_streams(rows.motors, "motors", rotor_command=(0, motors), battery_voltage=(motors, motors + 1)),
        *_streams(
            rows.setpoint, "setpoint", position_setpoint=(0, 3), velocity_setpoint=(3, 6), attitude_setpoint=(6, 10),
            rate_setpoint=(10, 13), thrust_setpoint=(13, 14),
        ),
    ]  # fmt: skip
    return Log(tuple(streams), _provenance(name, "measured"))


def _truth(rows: FlightRows, name: str) -> Log:
    width = len(rows.truth[0][1]) if rows.truth else 13
    parts = {"position": (0, 3), "velocity": (3, 6), "attitude": (6, 10), "rate": (10, 13), "rotor_speed": (13, width)}
    return Log(tuple(_streams(rows.truth, "truth", **parts)), _provenance(name, "true"))


def _streams(rows: list[tuple[float, Floats]], source: str, **parts: tuple[int, int]) -> list[Stream]:
    since_start = [(stamp, values) for stamp, values in rows if stamp > -1e-6]
    if not since_start:
        return []
    time = np.round([stamp for stamp, _ in since_start], 6)
    table = np.array([values for _, values in since_start])
    return [Stream(name, time, table[:, start:stop], source) for name, (start, stop) in parts.items()]


def _provenance(name: str, what: str) -> Provenance:
    return Provenance(name, "", f"simulated flight, {what}", "alula.lockstep")
