"""The mock flight controller: commander, navigator, parameters, links and vehicle, advanced together in simulated time.

No sockets and no clocks: bytes come in with `receive`, time with `advance`, bytes go out with `Link.take`. A process
in real time, a lockstep campaign and a unit test drive the same object.
"""

from __future__ import annotations

import random
from collections.abc import Hashable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from dynamics import quaternion
from sitl_mock.autopilot.commander import SEVERITY_NUMBER, Commander, Result
from sitl_mock.autopilot.commands import CommandHandler
from sitl_mock.autopilot.fault_schedule import Fault, FaultSchedule, FaultTargets
from sitl_mock.autopilot.modes import Mode
from sitl_mock.autopilot.navigator import Navigator
from sitl_mock.autopilot.offboard import Rule
from sitl_mock.autopilot.parameters import Parameters
from sitl_mock.autopilot.reception import Reception
from sitl_mock.autopilot.reporter import Reporter
from sitl_mock.vehicle.clock import VehicleClock
from sitl_mock.vehicle.vehicle_interface import Vehicle
from sitl_mock.wire import telemetry
from sitl_mock.wire.estimate_fault import EstimateFault
from sitl_mock.wire.link import Link
from sitl_mock.wire.signing import AutopilotSigning
from sitl_mock.wire.snapshot import Snapshot
from sitl_mock.wire.statustext import TextWriter
from sitl_mock.wire.streams import STEP, Role

UP = np.array([0.0, 0.0, 1.0])
MIN_UPRIGHTNESS = 0.5  # cosine of a tilt of 60 degrees, FD_FAIL_R and FD_FAIL_P


@dataclass(frozen=True, slots=True)
class Behaviour:
    """Where PX4 versions and set-ups differ, and what a scenario adds.

    rule: when OFFBOARD may begin.
    double_ack: DO_SET_MODE is answered twice.
    body_velocity: ODOMETRY's velocity in BODY_FRD.
    clock_drift: time that the vehicle's clock gains, s per second.
    clock_tick: s in which it counts; 0 for a clock that runs on.
    epoch: unix time at boot, s.
    faults: what goes wrong when.
    seed: of all randomness.
    """

    rule: Rule = "measured"
    double_ack: bool = False
    body_velocity: bool = False
    clock_drift: float = 2e-5
    clock_tick: float = 0.0
    epoch: float = 1.8e9
    faults: tuple[Fault, ...] = ()
    seed: int = 0


class Autopilot:
    """A flight controller with PX4's behaviour on its links, flying a vehicle.

    next_step: simulated time at which the next pass ends, s.
    estimates_sent: ODOMETRY messages that the last pass queued.
    signing: its key of MAVLink signing, if it has one.
    """

    def __init__(self, vehicle: Vehicle, parameters: Parameters, behaviour: Behaviour):
        self.vehicle = vehicle
        self.parameters = parameters
        self.system = int(parameters["MAV_SYS_ID"])
        self.links: list[Link] = []
        self.next_step = vehicle.time + STEP
        self.estimates_sent = 0
        self.signing = AutopilotSigning()
        self._random = random.Random(behaviour.seed)
        self.commander = Commander(parameters, rule=behaviour.rule, seed=behaviour.seed + 1)
        self.clock = VehicleClock(drift=behaviour.clock_drift, tick=behaviour.clock_tick)
        self.estimate_fault = EstimateFault(reset_counter=self._random.randint(9, 11))
        self._navigator = Navigator(vehicle, self.commander, parameters, self._random)
        self._reporter = Reporter(
            vehicle,
            self.commander,
            self._navigator,
            self.clock,
            self.estimate_fault,
            epoch=behaviour.epoch,
            body_velocity=behaviour.body_velocity,
        )
        self._faults = FaultSchedule(
            behaviour.faults, FaultTargets(self.commander, self.estimate_fault, self.clock, self.links, vehicle)
        )
        self._reception = Reception(
            vehicle,
            self.commander,
            parameters,
            CommandHandler(self.commander, self._navigator, self.estimate_fault, self._reporter),
            self.estimate_fault,
            self.clock,
            self.links,
            self.signing,
            double_ack=behaviour.double_ack,
            source=self._random,
        )
        self._writer = TextWriter()
        self._due = vehicle.time
        vehicle.tune(parameters.tuning())

    @property
    def time(self) -> float:
        """Simulated time, s."""
        return self.vehicle.time

    def add_link(self, name: str, role: Role) -> Link:
        """A further link with PX4's streams for its role."""
        seed = self._random.randrange(1 << 30)
        link = Link(name, role, self.system, frozenset(telemetry.BUILDERS), seed=seed, signing=self.signing)
        self.links.append(link)
        return link

    def receive(self, link: Link, peer: Hashable, data: bytes, time: float | None = None) -> None:
        """Take bytes that arrived on a link from a peer at a simulated time (s, now by default)."""
        arrival = self.time if time is None else time
        for message in link.parse(peer, data):
            self._reception.receive(link, arrival, message)

    def request(self, action: Literal["offboard", "land", "arm", "disarm"]) -> bool:
        """Arm, disarm or change the mode as a command would; returns whether that was accepted."""
        match action:
            case "arm":
                result = self._navigator.arm(self.time)
            case "disarm":
                result = self.commander.disarm(self.time)
            case "offboard" | "land":
                result = self.commander.set_mode(self.time, Mode[action.upper()])
        return result is Result.ACCEPTED

    def advance(self, duration: float) -> None:
        """Simulate a duration, s, in passes of 4 ms; what is to be sent waits in the links.

        A part of a pass that remains is simulated with the next call.
        """
        self._due = max(self._due, self.time) + duration
        while self.next_step <= self._due + 1e-9:
            self.step()

    def step(self) -> None:
        """One pass: decide, fly for 4 ms, queue the messages that are due."""
        self._faults.apply(self.time)
        self._watch_estimate()
        self._navigator.fly(STEP)
        self.next_step = self.time + STEP
        self._queue_messages(self.time)

    def _watch_estimate(self) -> None:
        has_position = self.vehicle.has_position
        if self.commander.has_position and not has_position:
            self.commander.lose_position()
        self.commander.has_position = has_position
        self.commander.upright = float(quaternion.rotate(self.vehicle.truth.attitude, UP)[2]) > MIN_UPRIGHTNESS
        self.estimate_fault.watch_position(has_position)

    def snapshot(self, time: float) -> Snapshot:
        """The content of all streams at a simulated time, s."""
        return self._reporter.snapshot(time)

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
                if link.has_gcs(time):
                    for message in self._writer.messages(SEVERITY_NUMBER[severity], text):
                        link.send(time, message)
