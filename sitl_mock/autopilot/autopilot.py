"""The mock flight controller: commander, parameters, links and vehicle, advanced together in simulated time.

No sockets and no clocks: bytes come in with `receive`, time with `advance`, bytes go out with `Link.take`. A process
in real time, a lockstep campaign and a unit test drive the same object.
"""

from __future__ import annotations

import random
from collections.abc import Hashable
from dataclasses import dataclass

import numpy as np

from sitl_mock.autopilot import reception
from sitl_mock.autopilot.commander import SEVERITY_NUMBER, Commander, Result
from sitl_mock.autopilot.fault_schedule import Fault, FaultSchedule
from sitl_mock.autopilot.modes import Mode
from sitl_mock.autopilot.offboard import Rule
from sitl_mock.autopilot.parameters import Parameters
from sitl_mock.vehicle.clock import VehicleClock
from sitl_mock.vehicle.position_control import is_home
from sitl_mock.vehicle.vehicle_interface import ControlSetpoint, Vehicle
from sitl_mock.wire import telemetry
from sitl_mock.wire.estimate_fault import EstimateFault
from sitl_mock.wire.link import Link
from sitl_mock.wire.snapshot import MotionEncoder, Snapshot, Standing, motor_order, ned
from sitl_mock.wire.statustext import TextWriter
from sitl_mock.wire.streams import STEP, Role

IDLE = ControlSetpoint("idle")
SPOOL_UP = (0.02, 0.06)  # s from arming to the first motor command
TYPE_OF_ROTORS = {4: 2, 6: 13, 8: 14}
ON_GROUND, IN_AIR, TAKING_OFF, LANDING = 1, 2, 3, 4


@dataclass(frozen=True, slots=True)
class Behaviour:
    """Where PX4 versions and set-ups differ, and what a scenario adds.

    rule: when OFFBOARD may begin. double_ack: DO_SET_MODE answered twice. body_velocity: ODOMETRY in BODY_FRD.
    clock_drift: s the vehicle's clock gains per second. epoch: unix time at boot, s.
    """

    rule: Rule = "documented"
    double_ack: bool = False
    body_velocity: bool = False
    clock_drift: float = 2e-5
    epoch: float = 1.8e9
    faults: tuple[Fault, ...] = ()
    seed: int = 0


class Autopilot:
    """A flight controller with PX4's behaviour on its links, flying a vehicle."""

    def __init__(self, vehicle: Vehicle, parameters: Parameters, behaviour: Behaviour):
        self.vehicle = vehicle
        self.parameters = parameters
        self.system = int(parameters["MAV_SYS_ID"])
        self.double_ack = behaviour.double_ack
        self.random = random.Random(behaviour.seed)
        self.commander = Commander(parameters, rule=behaviour.rule, seed=behaviour.seed + 1)
        self.clock = VehicleClock(drift=behaviour.clock_drift)
        self.estimate_fault = EstimateFault(reset_counter=self.random.randint(9, 11))
        self.links: list[Link] = []
        self.takeoff_altitude: float | None = None
        self.faults = FaultSchedule(behaviour.faults)
        self._epoch = behaviour.epoch
        self._child_frame = telemetry.BODY_FRD if behaviour.body_velocity else telemetry.LOCAL_NED
        self._encoder = MotionEncoder()
        self._writer = TextWriter()
        self._order = motor_order(vehicle.rotor_position)
        self._home = vehicle.estimate.position_world
        self._flown = IDLE
        self._flown_mode: Mode | None = None
        self._motors_from = 0.0
        self.next_step = vehicle.time + STEP
        self._due = vehicle.time
        self.estimates_sent = 0
        self.apply_parameters()

    @property
    def time(self) -> float:
        """Simulated time, s."""
        return self.vehicle.time

    def add_link(self, name: str, role: Role) -> Link:
        """A further link with PX4's streams for its role."""
        link = Link(name, role, self.system, frozenset(telemetry.BUILDERS), seed=self.random.randrange(1 << 30))
        self.links.append(link)
        return link

    def receive(self, link: Link, peer: Hashable, data: bytes, time: float | None = None) -> None:
        """Take bytes that arrived on a link from a peer at a simulated time (s, now by default)."""
        when = self.time if time is None else time
        for message in link.parse(peer, data):
            reception.receive(self, link, when, message)

    def advance(self, duration: float) -> None:
        """Simulate a duration, s, in passes of 4 ms; what is to be sent waits in the links.

        A part of a pass that is left over is simulated with the next call.
        """
        self._due = max(self._due, self.time) + duration
        while self.next_step <= self._due + 1e-9:
            self.step()

    def step(self) -> None:
        """One pass: decide, fly for 4 ms, queue the messages that are due."""
        self.faults.apply(self.time, self)
        commander = self.commander
        powered = commander.armed and not commander.terminated and self.time >= self._motors_from
        self._flown = self._setpoint() if commander.armed else IDLE
        self.vehicle.advance(self._flown, powered, STEP)
        self.next_step = self.time + STEP
        commander.update(self.time, landed=self.vehicle.on_ground)
        self._finish_takeoff()
        self._queue_messages(self.time)

    def arm(self, time: float, *, force: bool = False) -> Result:
        """Arm if PX4 would; the place becomes home, and the rotors start a little later."""
        was_armed = self.commander.armed
        result = self.commander.arm(time, force=force)
        if self.commander.armed and not was_armed:
            self.set_home()
            self._motors_from = time + self.random.uniform(*SPOOL_UP)
        return result

    def set_home(self) -> None:
        """The present position becomes home."""
        self._home = self.vehicle.estimate.position_world

    def fly_to(self, setpoint: ControlSetpoint) -> None:
        """Hold somewhere else, in the mode that is flown already."""
        self._flown = setpoint
        self._flown_mode = self.commander.mode

    def apply_parameters(self) -> None:
        """Hand changed gains to the inner loops."""
        self.vehicle.tune(self.parameters.tuning())

    def _setpoint(self) -> ControlSetpoint:
        commander = self.commander
        mode = commander.mode
        if mode is Mode.OFFBOARD:
            self._flown_mode = mode
            return commander.offboard.setpoint(self.time) or IDLE
        if commander.landed and mode is not Mode.TAKEOFF:
            self._flown_mode = None  # chosen again once in the air
            return self._flown if self._flown.kind == "land" else IDLE
        if mode is self._flown_mode:
            return self._flown
        self._flown_mode = mode
        return self._position_setpoint(mode)

    def _position_setpoint(self, mode: Mode) -> ControlSetpoint:
        if mode in (Mode.LAND, Mode.RTL):
            return ControlSetpoint("land" if mode is Mode.LAND else "rtl")
        here = np.array(self.vehicle.estimate.position_world)
        if mode is Mode.TAKEOFF:
            above_home = self._home[2] + self.parameters["MIS_TAKEOFF_ALT"]
            here[2] = self.takeoff_altitude if self.takeoff_altitude is not None else above_home
        return ControlSetpoint("hold", position_world=here)

    def _finish_takeoff(self) -> None:
        if self.commander.mode is Mode.TAKEOFF and self._flown_mode is Mode.TAKEOFF and self._flown.kind == "hold":
            height = float(self.vehicle.estimate.position_world[2])
            if abs(height - float(self._flown.position_world[2])) < 0.3:
                self.commander.finish_takeoff()
                self.fly_to(self._flown)

    def _queue_messages(self, time: float) -> None:
        self._queue_texts(time)
        snapshot = None
        self.estimates_sent = 0
        for link in self.links:
            link.flood(time, STEP)
            due = link.streams.due(time)
            if not due:
                continue
            snapshot = snapshot or self.snapshot(time)
            departure = link.loop_time(time)
            for identifier in due:
                if self.estimate_fault.stopped and identifier in telemetry.OF_THE_ESTIMATE:
                    continue
                self.estimates_sent += identifier == telemetry.ODOMETRY
                for message in telemetry.build(identifier, snapshot):
                    link.send(departure, message)

    def _queue_texts(self, time: float) -> None:
        while self.commander.texts:
            severity, text = self.commander.texts.popleft()
            for link in self.links:
                if link.sees_gcs(time):
                    for message in self._writer.messages(SEVERITY_NUMBER[severity], text):
                        link.send(time, message)

    def snapshot(self, time: float) -> Snapshot:
        """What the streams say at a simulated time, s."""
        commander = self.commander
        standing = Standing(
            base_mode=commander.base_mode(),
            custom_mode=commander.mode.custom_mode,
            system_status=int(commander.system_status(time)),
            landed_state=self._landed_state(),
            armable=commander.armed or commander.may_arm(time),
            vehicle_type=TYPE_OF_ROTORS.get(len(self._order), 2),
            child_frame=self._child_frame,
            epoch=self._epoch,
            home=ned(self._home),
            flown=self._flown,
        )
        return Snapshot(time, self.vehicle, self.clock, self.estimate_fault, self._encoder, self._order, standing)

    def _landed_state(self) -> int:
        if self.commander.landed:
            return ON_GROUND
        if self.commander.mode is Mode.RTL and is_home(self.vehicle.estimate.position_world, self._home):
            return LANDING
        return {Mode.TAKEOFF: TAKING_OFF, Mode.LAND: LANDING}.get(self.commander.mode, IN_AIR)
