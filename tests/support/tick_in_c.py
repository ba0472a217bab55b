"""The tick in C beside Python's path: a context with a solver of the test's own, and flights whose ticks C answers."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from math import inf
from typing import Any

import msgspec
import numpy as np

from dynamics.arrays import Floats
from dynamics.vehicle import Vehicle
from runtime.control.controller import Answer, Command, Controller
from runtime.flight.decision import Decision
from runtime.flight.health import HealthLimits
from runtime.flight.thrust import ThrustMap
from runtime.flight.tick_plan import TickPlan
from runtime.link.estimate import EstimateLimits, StateEstimate
from runtime.record.records import ObservationRecord
from runtime.tick import context
from runtime.tick.library import TickLibrary, tick_library
from tests.support.rate_controlled_vehicle import Flight

PROPAGATE = ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * 3, ctypes.c_double, ctypes.c_void_p)
FEEDBACK = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p)


def library() -> TickLibrary:
    """The compiled tick."""
    loaded = tick_library()
    assert loaded is not None
    return loaded


class FixedSolver:
    """A solver that holds every state and answers by given rates, rad/s, and rotor speeds, rad/s."""

    def __init__(self, rate: Floats, speeds: Floats, status: int = 0) -> None:
        self.states, self.inputs, self.status = np.zeros((2, 13)), np.array([speeds, speeds], dtype=float), status
        self.states[:, 10:13] = rate
        self.calls = 0
        self._functions = PROPAGATE(self._propagate), FEEDBACK(self._feedback)

    def _propagate(self, _: int, state: int, speeds: int, seconds: float, following: int) -> None:
        ctypes.memmove(following, state, 13 * 8)

    def _feedback(self, _: int, state: int) -> int:
        self.calls += 1
        return self.status

    def write(self, target: Any) -> None:
        """Into an alula_solver."""
        target.propagate, target.feedback = (ctypes.cast(each, ctypes.c_void_p).value for each in self._functions)
        target.states, target.inputs = self.states.ctypes.data, self.inputs.ctypes.data
        target.state_count, target.rotor_count = 13, self.inputs.shape[1]


class TickInC:
    """`alula_tick` of one controller, called in the test's thread; no socket."""

    def __init__(self, vehicle: Vehicle, controller: Controller, thrust_map: ThrustMap, health: HealthLimits) -> None:
        self.library, self.controller = library(), controller
        self.context: Any = self.library.structs["alula_context"]()
        context.write_messages(self.context.messages)
        context.write_limits(self.context.limits, EstimateLimits(), health)
        context.write_vehicle(self.context.vehicle, vehicle, controller, thrust_map)
        context.write_solver(self.context.solver, controller)
        self.context.link.socket = -1

    def answer(self, plan: TickPlan, estimate: StateEstimate, now: float) -> tuple[str, Any]:
        """The answer to an estimate: why it was left, "sent" if it was not, and the result."""
        result = self.library.structs["alula_result"]()
        result.received, result.time = estimate.received, estimate.time
        result.state[:] = estimate.state.tolist()
        context.write_plan(self.context.plan, plan, not_before=-inf)
        reason = self.library.waiting.alula_answer(ctypes.byref(self.context), now, ctypes.byref(result))
        return self.library.reasons[reason], result

    def taken(self, result: Any) -> Answer:
        """A result as the controller takes it."""
        states, rotors = self.controller.model.state_count, self.controller.model.input_count
        speeds = np.array(result.rotor_speed[:rotors])
        command = Command(np.array(result.solved_rate), result.solved_thrust, speeds, result.status, 0.0)
        return Answer(np.array(result.measured[:states]), np.array(result.acting[:states]), command)


class FlightInC(Flight):
    """A flight whose ticks C answers wherever the flight logic plans them.

    answered: how many. differing: times of ticks in which the flight logic decides something else than what left.
    late_findings: events that are observed once a setpoint has left.
    """

    def __init__(self, vehicle: Vehicle, controller: Controller, *arguments: Any, **named: Any) -> None:
        super().__init__(vehicle, controller, *arguments, **named)
        self.answered, self.differing, self.late_findings = 0, list[float](), dict[str, str]()
        self._c = TickInC(self.flyer.vehicle, controller, self.thrust_map, self.flyer.health_limits)
        self._decide: Callable[..., Decision] = self.flyer.step
        self._flown: StateEstimate | None = None
        self._observation: ObservationRecord | None = None
        self.flyer.step = self._step  # type: ignore[method-assign, assignment]

    def _step(self, observation: ObservationRecord, estimate: StateEstimate | None) -> Decision:
        plan, fresh = self.flyer.plan(), estimate is not self._flown
        self._flown, self._observation = estimate, None
        quiet = not (observation.findings or observation.reset or observation.engage or observation.leave)
        quiet &= observation.armed and observation.offboard and observation.connected and not observation.stop
        if plan is None or estimate is None or not fresh or not quiet:
            return self._decide(observation, estimate)
        reason, result = self._c.answer(plan, estimate, observation.time)
        if reason != "sent":
            return self._decide(observation, estimate)
        self.answered += 1
        findings = msgspec.json.encode(self.late_findings).decode() if self.late_findings else ""
        self._observation = msgspec.structs.replace(observation, answered=True, findings=findings)
        decision = self._decide(self._observation, estimate, self._c.taken(result))
        rates = decision.rate_body is not None and decision.rate_body.tolist() == list(result.rate)
        if not rates or decision.thrust != result.thrust or decision.collective_thrust != result.collective_thrust:
            self.differing.append(observation.time)
        return decision

    def _keep(self, observation: ObservationRecord, decision: Decision) -> None:
        super()._keep(self._observation or observation, decision)
