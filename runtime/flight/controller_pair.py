"""The controllers of a flight: the one that flies, the nominal one ready to replace it, their last solution. Pure."""

from __future__ import annotations

from collections.abc import Collection
from math import inf

from dynamics.arrays import Floats
from runtime.control.adaptation import Adaptation, FollowedValue
from runtime.control.controller import Answer, Command, Controller
from runtime.flight.events import Event, Fallback
from runtime.flight.shifted import ShiftedSolution
from runtime.link.estimate import StateEstimate
from runtime.record.records import ObservationRecord

STALE_SOLUTION = 0.2  # s without a solution after which the solver is reset
Window = tuple[Floats, Floats]


class ControllerPair:
    """The main controller, and the nominal one: of the vehicle file's model, the fallback of a learned one.

    main: the controller that flies unless a fallback requires the other one.
    nominal: None where the main one flies the vehicle file's model already.
    prepared: whether the main controller is prepared for the next tick.
    shifted: the last solution and its continuation.
    answer: that the main controller's solver has given to this tick's estimate already, None where it has not.
    """

    def __init__(self, main: Controller, nominal: Controller | None) -> None:
        self.main, self.nominal = main, nominal
        self.prepared = False
        self.answer: Answer | None = None
        self.shifted = ShiftedSolution()
        self._nominal_ready = False
        self._flying = main
        self._failed: Controller | None = None
        self._solution: tuple[float, Command, Controller] | None = None
        self._last_solution = -inf

    @property
    def adaptation(self) -> Adaptation | None:
        """Of the controller that flies, None where its model does not follow."""
        return self._flying.adaptation

    @property
    def adaptations(self) -> list[Adaptation]:
        """Of all controllers whose model follows."""
        return [each.adaptation for each in self._both if each.adaptation is not None]

    @property
    def followed(self) -> dict[str, FollowedValue]:
        """The parameters that the flying controller's model follows, and losses of rotors, by name."""
        values = {} if self.adaptation is None else dict(self.adaptation.values)
        return values | {name: value for each in self.adaptations for name, value in each.losses}

    @property
    def _both(self) -> list[Controller]:
        return [controller for controller in (self.main, self.nominal) if controller is not None]

    def start(self, state: Floats, time: float) -> None:
        """Start to fly from a state (13,)."""
        for controller in self._both:
            controller.reset(state, time)
        self.prepared, self._last_solution = False, time

    def solve(self, estimate: StateEstimate, time: float, fallback: Fallback) -> Command | None:
        """A fresh solution, which may have a fault; None when there is none or it may not be flown. time: s."""
        if fallback is Fallback.SHIFTED_SOLUTION or not self.prepared:
            return None
        falls_back = fallback is Fallback.NOMINAL_MODEL and self._nominal_ready
        controller = self.nominal if falls_back and self.nominal is not None else self.main
        answer, self.answer = self.answer, None
        if answer is None:
            command = controller.feedback(controller.compensate(estimate.state, estimate.time, time), time)
        else:
            command = controller.take(answer, estimate.time, time)
        if command.fault:
            self._failed = controller
        else:
            self._solution, self._flying = (time, command, controller), controller
            self._last_solution = time
        return command

    # --- the fallbacks

    def solution_left(self, active: Collection[Event], time: float) -> bool:
        """Whether the last prediction covers a time, s, and may be flown. active: events."""
        diverges = Event.MODEL_OSCILLATES in active and self.shifted.controller is self.main
        return self.shifted.reaches(time) and not diverges

    def nominal_available(self, active: Collection[Event]) -> bool:
        """Whether the controller of the vehicle file's model is ready. active: events."""
        failed = (self._failed or self.main) if Event.SOLVER_FAILED in active else None
        return failed is not (self.nominal or self.main) and (self._nominal_ready or self.nominal is None)

    # --- after the setpoint has left

    def store_solution(self) -> None:
        """Keep the tick's solution for its continuation."""
        if self._solution is not None:
            self.shifted.keep(*self._solution)
            self._solution = None

    def sent(self, collective_thrust: float, time: float, effectiveness: float) -> None:
        """Take the thrust that was sent, N, where a model follows. effectiveness: thrust per modelled thrust."""
        if self.main.adaptation is not None:
            for controller in self._both:
                controller.sent(collective_thrust, time, effectiveness)

    def read_rotors(self, observation: ObservationRecord, *, free: bool) -> None:
        """Take an observation's force and rotor speeds. free: whether the ground carries no part of the vehicle."""
        for adaptation in self.adaptations:
            adaptation.read_force(observation.time, observation.specific_force_z)
            if observation.rotor_speed.size and free:
                speed, measured = observation.rotor_speed, observation.rotors_measured
                adaptation.read_rotors(observation.rotor_time, speed, measured=measured)

    def follow(self, state: Floats, estimate: StateEstimate | None, time: float) -> None:
        """Reset the main solver after a time without solutions, and let it follow a nominal one that flies."""
        if time - self._last_solution > STALE_SOLUTION:
            self.main.reset(state, time)
        if estimate is not None and self.nominal is not None and self._flying is self.nominal:
            self.main.keep_warm(self.nominal, estimate.state, estimate.time, time)

    def model_events(self, time: float) -> dict[Event, str]:
        """The reasons against flying a learned model at the next tick, and what its adaptation reports. time: s."""
        waiting, outside, unfit = self.main.model_faults(time)
        texts = {Event.MODEL_WAITING: waiting, Event.MODEL_OUTSIDE: outside, Event.MODEL_UNHEALTHY: unfit}
        if (adaptation := self.main.adaptation) is not None:
            texts[Event.MODEL_CHANGED] = adaptation.changed
            texts[Event.PUSHED] = adaptation.excess if adaptation.flies else ""
            texts[Event.ADAPTATION_REFUSED] = adaptation.refusal
        return {event: text for event, text in texts.items() if text}

    def prepare(
        self,
        state: Floats,
        estimate: StateEstimate | None,
        window: Window,
        time: float,
        *,
        nominal_required: bool,
        diverging: bool,
    ) -> None:
        """Linearise for the next tick.

        window: states and rotor speeds to track. nominal_required: whether an event requires a fallback.
        diverging: whether the learned model has just made the vehicle oscillate.
        """
        self._ready_nominal(state, estimate, time, required=nominal_required, diverging=diverging)
        self.main.prepare(*window)
        self.prepared = True
        if self.nominal is not None and self._nominal_ready:
            self.nominal.prepare(*window)

    def _ready_nominal(
        self, state: Floats, estimate: StateEstimate | None, time: float, *, required: bool, diverging: bool
    ) -> None:
        """Keep the nominal controller ready while a learned model flies, and while an event requires a fallback.

        Before either is prepared, which moves their inputs to the next tick.
        """
        if self.nominal is None or not (required or self.main.is_learned):
            self._nominal_ready = False
            return
        # after a divergence the nominal controller starts from hover inputs, not from the diverged plan
        if diverging or not self._nominal_ready:
            self.nominal.reset(state, time)
        if not diverging and estimate is not None and self._flying is not self.nominal:
            self.nominal.keep_warm(self.main, estimate.state, estimate.time, time)
        self._nominal_ready = True
