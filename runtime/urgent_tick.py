"""The urgent half of a tick beside the interpreter: armed by the control thread, answered by a thread in C.

The flight logic stays the one that decides. After each tick it says what the next one flies if nothing but its estimate
is new (`Flyer.plan`); `alula_tick` flies that as soon as the estimate's datagram is there, or leaves the tick to Python
and says why. What it did goes through the flight logic afterwards, which computes the same setpoint from the recorded
tick again (`runtime.replay`).
"""

from __future__ import annotations

import os
from collections import Counter
from dataclasses import dataclass

import numpy as np

from dynamics.arrays import Floats
from runtime.control.controller import Answer, Command
from runtime.flight.decision import Decision
from runtime.flight.flyer import Flyer
from runtime.flight.tick_plan import TickPlan
from runtime.link.estimate import StateEstimate
from runtime.link.link import Link
from runtime.tick import context
from runtime.tick.library import TickLibrary, tick_library
from runtime.tick.receiver import Receiver

PATIENCE = 0.05  # s for the link's thread to handle a datagram that was answered
SWITCH = "ALULA_TICK"  # environment: "python" leaves every tick to the interpreter, to compare


@dataclass(frozen=True)
class Sent:
    """A setpoint that has left.

    answer: of the solver.
    estimate: that it answers.
    rate_body: (3,) rad/s, thrust: 0..1, and collective_thrust: N, as they left.
    now, departed: s. busy: s of the processor between them.
    """

    answer: Answer
    estimate: StateEstimate
    rate_body: Floats
    thrust: float
    collective_thrust: float
    now: float
    departed: float
    busy: float

    def equals(self, decision: Decision) -> bool:
        """Whether the flight logic has decided the same, to the last bit."""
        same = decision.rate_body is not None and np.array_equal(decision.rate_body, self.rate_body)
        return same and decision.thrust == self.thrust


class UrgentTick:
    """A flight's ticks in C. All but `disarm` belong to the control thread.

    left: ticks that were armed and left to Python, by reason.
    """

    def __init__(self, link: Link, flyer: Flyer, library: TickLibrary) -> None:
        self._link, self._flyer, self._library = link, flyer, library
        self._receiver: Receiver | None = None
        self._controller = flyer.controllers.main
        self._snapshot: tuple[object, ...] = ()
        self._armed = False
        self.left: Counter[str] = Counter()

    @classmethod
    def of(cls, link: Link, flyer: Flyer) -> UrgentTick | None:
        """The ticks of a flight; None where none can be flown in C: another transport, a network, no library."""
        if os.environ.get(SWITCH) == "python" or (library := tick_library()) is None:
            return None
        return cls(link, flyer, library) if context.fits(flyer.controllers.main, library) else None

    def start(self) -> bool:
        """Start the thread, with the scheduling of the one that calls this. Returns whether there is one now."""
        reader = self._link.read_by(self._receive, self._know)
        return reader is not None

    def _receive(self, descriptor: int, sequence: int) -> Receiver:
        receiver = Receiver(self._library, descriptor)
        target, flyer = receiver.context, self._flyer
        context.write_messages(target.messages)
        context.write_limits(target.limits, self._link.peer.estimates.limits, flyer.health_limits)
        context.write_vehicle(target.vehicle, flyer.vehicle, self._controller, flyer.output.thrust_map)
        context.write_solver(target.solver, self._controller)
        target.sequence, receiver.link.socket = sequence, descriptor
        self._receiver = receiver
        return receiver

    def _know(self) -> None:
        """Let the thread know the link as it is; called by the link's thread."""
        link, receiver = self._link, self._receiver
        address, own = link.peer.address, (link.own_system, link.own_component)
        if receiver is None or address is None:
            return
        peer = link.peer
        latest = peer.estimates.latest
        snapshot = address, own, peer.clock.conversion, None if latest is None else latest.received
        if snapshot == self._snapshot and not link.signing.is_required:
            return
        self._snapshot = snapshot
        context.write_link(receiver.link, vehicle=address, own=own, clock=peer.clock, estimates=peer.estimates)
        context.write_signing(receiver.link, link.signing, address, link.setpoint_timestamp)
        receiver.know()

    def arm(self, plan: TickPlan, not_before: float) -> None:
        """Let the next estimate be answered by a plan. not_before: s, arrival of the first one that is due."""
        if self._receiver is not None:
            context.write_plan(self._receiver.context.plan, plan, not_before=not_before)
            self._receiver.result.reason, self._armed = 0, True
            self._receiver.arm()

    def disarm(self) -> None:
        """Leave the next tick to Python, after news that it must not leave out; from any thread."""
        if self._receiver is not None:
            self._receiver.disarm()

    def claim(self) -> Sent | None:
        """Disarm; the setpoint that has left since the tick was armed, None where Python is to fly this tick."""
        receiver = self._receiver
        if receiver is None:
            return None
        result, model = receiver.result, self._controller.model
        if not receiver.claim():
            if self._armed:
                self.left[receiver.reasons[result.reason] if result.reason else "no estimate came"] += 1
            self._armed = False
            return None
        self._armed = False
        states, rotors = model.state_count, model.input_count
        estimate = self._link.take_answer(result.received, PATIENCE)
        if estimate is None:  # the link's thread did not come to it: the same numbers
            state = np.array(result.state)
            estimate = StateEstimate(result.time, result.received, state, result.reset_counter, True, "ODOMETRY")
        self._link.answered(result.timestamp, bytes(result.frame[: result.frame_size]), result.departed)
        command = Command(
            np.array(result.solved_rate),
            result.solved_thrust,
            np.array(result.rotor_speed[:rotors]),
            result.status,
            self._controller.solver.report.feedback_seconds,
        )
        answer = Answer(np.array(result.measured[:states]), np.array(result.acting[:states]), command)
        thrust = result.thrust, result.collective_thrust
        return Sent(answer, estimate, np.array(result.rate), *thrust, result.now, result.departed, result.busy)
