"""One tick of the control thread as a pure object: observation and estimate in, setpoint, requests and changes out.

`step` is the urgent half, `prepare` follows once the setpoint has left. No clock, no input or output: the daemon feeds
it from the link, the replay from a recording, and both get the same setpoints.
"""

from __future__ import annotations

from math import inf

import numpy as np

from dynamics.arrays import Floats
from dynamics.state import ATTITUDE
from dynamics.vehicle import Vehicle
from runtime.control.controller import Answer, Command, Controller
from runtime.flight.controller_pair import ControllerPair
from runtime.flight.decision import Decision, Ending, FlyerSettings
from runtime.flight.engagement import AutopilotRequest, Engagement, Facts, State
from runtime.flight.events import POLICIES, Event, EventChange, EventMonitor, Fallback
from runtime.flight.failsafe import SUSTAINED, FallbackChain, LevelHold, level_rate
from runtime.flight.flight_checks import FlightChecks
from runtime.flight.ground_probe import Ground
from runtime.flight.health import HealthLimits
from runtime.flight.last_setpoint import USUAL_LOSS_TIME, LastSetpointGuard
from runtime.flight.measurements import Measurements
from runtime.flight.mission import Mission
from runtime.flight.parting import Parting
from runtime.flight.phases import Handler
from runtime.flight.setpoint_output import SetpointOutput
from runtime.flight.settling import SHUTDOWN_TIME, Settling
from runtime.flight.takeoff import HandOver
from runtime.flight.takeoff_control import TakeoffControl
from runtime.flight.thrust import EffectivenessEstimator, ThrustMap
from runtime.flight.tick_plan import TickPlan, leaves_tick
from runtime.link.estimate import StateEstimate
from runtime.record.records import ObservationRecord

ZERO = np.zeros(3)
STOPPED = "stopped streaming at once"
DISARM_PATIENCE = 10.0  # s until the autopilot is requested to land and disarm
DISARM_PERIOD = 0.5  # s between requests to disarm: PX4 refuses the first ones, until its own land detector agrees
SINK_GAIN, SINK_LIMIT = 3.0, 2.0  # 1/s and rad/s, of levelling where thrust is lost
SINK_SHARE = 0.95  # of the weight, thrust of a level hold while landing
CATCH_TIME = 0.15  # s in which the controller takes over after a false contact
_UNUSABLE = (Event.ESTIMATE_STALE, Event.ESTIMATE_FROZEN, Event.INPUT_NOT_FINITE, Event.CLOCK_BACKWARDS)


class Flyer:
    """The flight logic: engagement, mission phases, controller, fallbacks, thrust.

    motors: for each rotor the index of the autopilot's motor, None where it is not known.
    last_setpoint: the check of setpoints that may be the last ones.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        controller: Controller,
        mission: Mission,
        thrust_map: ThrustMap,
        settings: FlyerSettings,
        *,
        nominal: Controller | None = None,
        loss_time: float = USUAL_LOSS_TIME,
    ) -> None:
        """nominal: controller of the vehicle file's model, the fallback of a learned one; None without one.

        loss_time: the autopilot's COM_OF_LOSS_T, s.
        """
        self.motors: tuple[int, ...] | None = None
        self.engagement = Engagement(settings.engagement)
        self.events = EventMonitor()
        self.mission = mission
        self.controllers = ControllerPair(controller, nominal)
        self.output = SetpointOutput(vehicle, thrust_map, settings.thrust)
        self._settings, self._vehicle = settings, vehicle
        self._measured = Measurements()
        self._checks = FlightChecks(
            vehicle, settings, self.engagement, mission, self.controllers, self.output, self._measured
        )
        self._chain = FallbackChain(settings.bounds)
        self._hold = LevelHold(vehicle.weight)
        self._parting = Parting(self._hold, settings.period)
        response = settings.thrust.delay + settings.thrust.response_time
        self._takeoff = TakeoffControl(vehicle, thrust_map.thrust_max, response)
        self.last_setpoint = LastSetpointGuard(controller, nominal, mission, settings.last_setpoint, loss_time)
        self._settling = Settling(vehicle.weight, min(vehicle.limits.rate[:2]))
        self._ending = Ending()
        self._last_disarm_request = -inf
        self._standing = False  # whether the flight begins on the ground

    @property
    def over(self) -> bool:
        """Whether the flight is over: flown and given up, or refused, and its last setpoints sent."""
        ended = not self.engagement.streaming and bool(self.engagement.refusal) and not self.engagement.requested
        return ended and not self._parting.active

    @property
    def landed(self) -> bool:
        """Whether the flight ended on the ground, by its own landing."""
        return self.over and self.mission.policy.handler is Handler.SHUT_DOWN and self._ending.landed

    @property
    def effectiveness(self) -> EffectivenessEstimator:
        """Thrust per modelled thrust."""
        return self.output.effectiveness

    @property
    def vehicle(self) -> Vehicle:
        """The vehicle as it hovers."""
        return self._vehicle

    @property
    def health_limits(self) -> HealthLimits:
        """How old an estimate may be, and others."""
        return self._checks.health.limits

    @property
    def horizon(self) -> tuple[Floats, Floats] | None:
        """Predicted states (N + 1, nx) and rotor speeds (N, rotors) while the controller flies; views."""
        main = self.controllers.main
        return (main.predicted_states, main.predicted_inputs) if self.controllers.prepared else None

    def plan(self) -> TickPlan | None:
        """The next tick, once this one is prepared, if the controller will fly it; None where that is not certain."""
        main, flies = self.controllers.main, self.engagement.state is State.ENGAGED
        if not flies or self.mission.policy.handler is not Handler.FLY or not self.controllers.prepared:
            return None
        milder = self.events.fallback in SUSTAINED and self._chain.current in SUSTAINED
        lands = bool(self.events.landing_reason) and not self.mission.landing_reason
        unusual = lands or self.events.sinks or bool(self._measured.heading.correction)
        if (
            unusual
            or not milder
            or self.controllers.nominal is not None
            or main.is_learned
            or not leaves_tick(self._checks.pending)
        ):
            return None
        before, correction = self._measured.correction
        limit, value = self.mission.policy.tilt_rate, self.effectiveness.value
        model = self.last_setpoint.planned(self.output)
        return TickPlan(main, before, correction, limit, self.output.hand_over, value, model, self.output.last_thrust)

    def step(
        self, observation: ObservationRecord, estimate: StateEstimate | None, answer: Answer | None = None
    ) -> Decision:
        """Decide what to send now. estimate: the newest accepted one, the same object while there is no newer.

        answer: that the solver has given to this estimate already. Where its setpoint has left as well, by the plan of
        the tick before, the observation says so: then what is observed acts from the next tick on.
        """
        decision, measured = Decision(), self._measured
        if observation.engage:
            decision.event_changes += self.events.rearm(observation.time)
            self.engagement.engage()
        measured.take(observation, estimate, aloft=self.engagement.flying and self.mission.airborne)
        self._checks.attribution.observe(observation.time, estimate, fresh=measured.fresh)
        if observation.reset:
            self.mission.shift(observation.reset_position, observation.reset_yaw)
        if measured.fresh and measured.heading.turned:
            self.mission.shift(ZERO, measured.heading.turned)
        if measured.fresh:
            self._take_estimate(observation)
        self.controllers.answer = answer
        if observation.answered:
            self._fly(observation, decision)
            assert decision.rate_body is not None
            self._finish(observation, decision, decision.rate_body)
            measured.take_turn()
        decision.event_changes += self.events.update(
            self._checks.present(observation, self._takeoff.pose, self.motors), observation.time
        )
        self._probe_ground(decision.event_changes, observation.time)
        fallback = self._choose_fallback(observation.time)
        was_streaming, was_flying = self.engagement.streaming, self.engagement.flying
        if not observation.answered:
            decision.fallback = fallback
        self._engage(observation, decision, fallback)
        if self.engagement.streaming:
            self._parting.cancel()
            self._command(observation, decision)
        elif was_streaming:
            self._part(observation, decision, flown=was_flying)
        if not self.engagement.streaming:
            if not observation.answered:
                self._send_last(observation, decision)
            self._checks.health.rest()
        return decision

    def prepare(self, time: float) -> None:
        """Advance the mission and linearise for the next tick, after the setpoint has left. time: s, of this tick."""
        if (observation := self._measured.take_observation()) is not None:
            self.controllers.read_rotors(observation, free=not self.mission.policy.lands)
        self._checks.take_sent()
        state = self._measured.state
        self._look_ahead(state)
        if not self.engagement.flying or state is None or not self.mission.airborne:
            self._checks.measure_force(time, None)
            self.controllers.prepared = False
            return
        self.controllers.store_solution()
        if self._measured.estimate is not None and self._measured.moved_on:
            self._checks.check_flight(self._measured.estimate, time)
        self.mission.update(state, time)
        reference, window = self._window(state, time)
        self._checks.measure_force(time, reference)
        self.controllers.follow(state, self._measured.estimate, time)
        self._checks.pending |= self.controllers.model_events(time)
        self.controllers.prepare(
            state,
            self._measured.estimate,
            window,
            time,
            nominal_required=self.events.fallback is not Fallback.NONE,
            diverging=Event.MODEL_OSCILLATES in self._checks.pending
            and Event.MODEL_OSCILLATES not in self.events.active,
        )

    def reference_now(self, time: float) -> Floats | None:
        """The reference's state (13,) at a time, s; None when nothing is tracked."""
        if not self.mission.airborne or self._measured.state is None:
            return None
        states, _ = self.mission.window(np.array([time]), self._measured.state[ATTITUDE])
        return np.asarray(states[0])

    # --- observation

    def _take_estimate(self, observation: ObservationRecord) -> None:
        estimate = self._measured.estimate
        assert estimate is not None
        if not self.engagement.flying:
            self._takeoff.pose.add(estimate.state, observation.time, moved=observation.reset)
        if self._checks.health.is_current(estimate, observation.time):
            self._hold.observe(estimate.attitude)

    def _choose_fallback(self, time: float) -> Fallback:
        if not self.engagement.flying:
            return self.events.fallback
        if not self.mission.policy.falls_back:
            return Fallback.NONE
        active, estimate = self.events.active, self._measured.estimate
        if Event.ESTIMATE_STALE in active and estimate and self._checks.health.is_current(estimate, time):
            active = {event: detail for event, detail in active.items() if event is not Event.ESTIMATE_STALE}
        chosen = self._chain.choose(
            active,
            time=time,
            estimate_usable=self._measured.state is not None and not any(event in active for event in _UNUSABLE),
            solution_left=not self.mission.airborne or self.controllers.solution_left(active, time),
            nominal_available=self.controllers.nominal_available(active),
        )
        # without a learned model the vehicle file's model flies already
        return Fallback.NONE if chosen is Fallback.NOMINAL_MODEL and self.controllers.nominal is None else chosen

    # --- engagement

    def _engage(self, observation: ObservationRecord, decision: Decision, fallback: Fallback) -> None:
        was_flying = self.engagement.flying
        if was_flying and self.mission.policy.may_disarm and not observation.armed:
            self.mission.disarmed(observation.time)
            decision.transitions += self.engagement.release(self._ending.describe("and disarmed"), observation.time)
        facts = Facts(
            connected=observation.connected,
            armed=observation.armed,
            offboard=observation.offboard,
            mode=observation.mode,
            refusal=self.events.refusal,
            fallback=fallback,
            reason=self._chain.reason if was_flying else self.events.reason,
            standstill=self._checks.standstill,
        )
        decision.transitions += self.engagement.update(facts, observation.time)
        decision.requests = self.engagement.requests
        if not was_flying:
            self._standing = observation.landed or not self.engagement.initially_armed
        if observation.stop:
            decision.transitions += self.engagement.release(STOPPED, observation.time)
        if self.engagement.state is State.ENGAGED and not was_flying:
            self._begin(observation.time)
        state = self._measured.state
        if self.engagement.flying and state is not None:
            if observation.leave:
                self.mission.land(observation.leave, state, observation.time)
            elif self.events.landing_reason:
                self._land(self.events.landing_reason, state, observation.time)
        elif observation.leave:
            decision.transitions += self.engagement.release(observation.leave, observation.time)

    def _begin(self, time: float) -> None:
        """Start to fly after control was taken: from the ground by the ramp, in the air at once."""
        state = self._measured.state
        if state is None:
            return
        if self._standing:
            self.mission.ramp(self._takeoff.pose.median(state), time)
        else:
            self.mission.take_over(state, time)
            self.controllers.start(state, time)
        self._checks.pending |= self.last_setpoint.begin()

    def _look_ahead(self, state: Floats | None) -> None:
        """Look at a part of the flight that is planned, from the moment on in which control is to be taken."""
        if not self.engagement.streaming:
            self.last_setpoint.forget_plan()
        elif state is not None:
            flying = self.engagement.flying
            place = state if flying or not self._standing else self._takeoff.pose.median(state)
            self._checks.pending |= self.last_setpoint.look_ahead(place, standing=self._standing, flying=flying)

    def _land(self, reason: str, state: Floats, time: float) -> None:
        """Cut the flight short after an event, or a take-off before it leaves the ground."""
        if self.mission.policy.handler is Handler.TAKE_OFF:
            self._ending.not_flown = reason
        self.mission.land(reason, state, time)
        if self.events.sinks:
            self.mission.sink(state, time)

    # --- setpoint

    def _command(self, observation: ObservationRecord, decision: Decision) -> None:
        if observation.answered:
            if self.engagement.flying:
                self._look_for_ground(observation, decision.collective_thrust)
            return
        if self.engagement.flying:
            match self.mission.policy.handler:
                case Handler.WAIT:
                    pass
                case Handler.TAKE_OFF:
                    self._take_off(observation, decision)
                case Handler.FLY if decision.fallback is Fallback.LEVEL_HOLD:
                    self._hold_level(decision)
                case Handler.FLY:
                    self._fly(observation, decision)
                case Handler.SETTLE:
                    self._settle(observation, decision)
                case Handler.SHUT_DOWN:
                    self._shut_down(observation, decision)
        else:
            self._stand_by(decision)
        if self.engagement.flying:
            self._look_for_ground(observation, decision.collective_thrust)
        if self.engagement.streaming and decision.rate_body is not None:
            self._finish(observation, decision, decision.rate_body)
        else:
            decision.rate_body = None

    def _stand_by(self, decision: Decision) -> None:
        """Setpoints before control is taken: idle on the ground, level and hovering in the air."""
        if self.engagement.initially_armed:
            decision.rate_body, decision.collective_thrust = self._hold.command(0.0)
        else:
            decision.rate_body, decision.collective_thrust = ZERO, 0.0

    def _hold_level(self, decision: Decision) -> None:
        decision.rate_body, decision.collective_thrust = self._hold.command(self._settings.period)
        if self.mission.policy.lands:
            decision.collective_thrust *= SINK_SHARE

    def _take_off(self, observation: ObservationRecord, decision: Decision) -> None:
        state, time = self._measured.state, observation.time
        assert state is not None
        decision.rate_body = ZERO
        if decision.fallback >= Fallback.LEVEL_HOLD:
            self._land(self._chain.reason, state, time)
            return
        decision.rate_body, decision.collective_thrust = self._takeoff.command(state, self._measured.force, time)
        self._checks.pending |= self._takeoff.findings(state)
        ramp = self._takeoff.ramp
        if not ramp.lifted:
            return
        self.effectiveness.start(ramp.effectiveness)
        self.output.hand_over = HandOver(time, ramp.collective_thrust * self.effectiveness.value)
        self.mission.climb(state, time)
        self.controllers.start(state, time)
        decision.collective_thrust = self.output.hand_over.collective_thrust

    def _shut_down(self, observation: ObservationRecord, decision: Decision) -> None:
        since = observation.time - self.mission.phase_started
        decision.rate_body = ZERO
        decision.collective_thrust = self._settling.shut_down(since, self.output.last_thrust)
        if since > DISARM_PATIENCE:
            decision.requests = (AutopilotRequest.LAND,)
            reason = self._ending.describe("and left to the autopilot to disarm")
            decision.transitions += self.engagement.release(reason, observation.time)
        elif since > SHUTDOWN_TIME and observation.time - self._last_disarm_request > DISARM_PERIOD:
            self._last_disarm_request = observation.time
            decision.requests = (AutopilotRequest.DISARM,)

    def _probe_ground(self, raised: list[EventChange], time: float) -> None:
        """Reduce thrust in flight, after an event that may have been the ground, to find out whether it was."""
        cause = next((change for change in raised if change.active and POLICIES[change.event].probes), None)
        state = self._measured.state
        if cause is None or not self.engagement.flying or not self.mission.airborne or state is None:
            return
        self.mission.land(cause.text, state, time)
        self._take_thrust_away(state, time, cause.text)

    def _take_thrust_away(self, state: Floats, time: float, cause: str = "") -> None:
        """cause: event after which the ground is probed in flight; empty in a landing."""
        self._settling.begin(state, self.output.last_thrust, time, cause=cause)
        self.mission.settle(state, time)

    def _settle(self, observation: ObservationRecord, decision: Decision) -> None:
        """Level, with thrust going away, until the ground is known to carry the vehicle or not to be there."""
        time, ground, state, estimate = (
            observation.time,
            self._checks.ground,
            self._measured.state,
            self._measured.estimate,
        )
        assert state is not None
        usable = not any(event in self.events.active for event in _UNUSABLE)
        current = usable and estimate is not None and self._checks.health.is_current(estimate, time)
        low = ground.may_be_near(self.mission, state, reported_landed=observation.landed)
        decision.rate_body, decision.collective_thrust, verdict = self._settling.command(
            state, ground.meter, time, current=current, low=low
        )
        match verdict:
            case Ground.CARRIES:
                if cause := self._settling.cause or ground.blow:
                    self._ending.crashed = self._checks.pending[Event.CRASHED] = cause
                self.mission.shut_down(state, time)
            case Ground.ABSENT:
                self._checks.pending[Event.CONTACT_LOST] = ""
                self.output.hand_over = HandOver(time, decision.collective_thrust, CATCH_TIME)
                self.mission.catch(state, time)
                self.controllers.start(state, time)
            case Ground.OPEN:
                pass

    def _fly(self, observation: ObservationRecord, decision: Decision) -> None:
        state, hand_over, shifted = self._measured.state, self.output.hand_over, self.controllers.shifted
        command = self._solve(observation.time, decision)
        if command is not None:
            decision.rate_body, decision.collective_thrust = command.rate_body, command.collective_thrust
        elif decision.fallback is Fallback.SHIFTED_SOLUTION and shifted.reaches(observation.time):
            decision.rate_body, decision.collective_thrust = shifted.at(observation.time)
        elif not self.controllers.prepared and hand_over is not None:
            decision.rate_body, decision.collective_thrust = ZERO, hand_over.collective_thrust
        else:
            decision.fallback = max(decision.fallback, Fallback.LEVEL_HOLD)
            decision.rate_body, decision.collective_thrust = self._hold.command(self._settings.period)
        if self.events.sinks and state is not None:
            # thrust stays the controller's, which takes all that there is while the vehicle sinks too fast
            decision.rate_body = level_rate(state[ATTITUDE], gain=SINK_GAIN, limit=SINK_LIMIT)
        elif (limit := self.mission.policy.tilt_rate) < inf:
            decision.rate_body[:2] = np.clip(decision.rate_body[:2], -limit, limit)
        if hand_over is not None:
            decision.collective_thrust = hand_over.blend(decision.collective_thrust, observation.time)

    def _solve(self, time: float, decision: Decision) -> Command | None:
        """A fresh solution; None when there is none or it may not be flown."""
        assert self._measured.estimate is not None
        command = self.controllers.solve(self._measured.estimate, time, decision.fallback)
        if command is None:
            return None
        decision.solver_status, decision.feedback_seconds = command.status, command.seconds
        if not command.fault:
            if command.cut:
                self._checks.pending[Event.SOLVER_CUT] = (
                    f"{self.controllers.main.options.problem.iterations} iterations"
                )
            return command
        self._checks.pending[Event.SOLVER_FAILED] = command.fault
        decision.fallback = self._chain.replace_solution(Event.SOLVER_FAILED, command.fault)
        return None

    def _look_for_ground(self, observation: ObservationRecord, collective_thrust: float) -> None:
        """Take thrust away once a landing has reached the ground."""
        state = self._measured.state
        if state is None:
            return
        policy, time, reported = self.mission.policy, observation.time, observation.landed
        if self._checks.ground.has_landed(policy, state, collective_thrust, time, reported_landed=reported):
            self._take_thrust_away(state, time)
        else:
            self._checks.pending |= self._checks.ground.missing_ground(time)

    # --- the end of the stream

    def _part(self, observation: ObservationRecord, decision: Decision, *, flown: bool) -> None:
        """Begin the last setpoints of a stream that has just ended, and hand a vehicle in the air to a mode that lands.

        Its failsafe may return to launch, and climb. Who changed the mode, or commands the vehicle as well, keeps it.
        """
        if not observation.armed:
            return
        thrust = self._held_thrust(observation, flown=flown)
        aloft = thrust >= self._vehicle.weight
        self._parting.begin(observation.time, thrust, levels=aloft and observation.offboard)
        if aloft and flown and observation.offboard and Event.OTHER_CONTROLLER not in self.events.active:
            decision.requests = (AutopilotRequest.LAND,)

    def _held_thrust(self, observation: ObservationRecord, *, flown: bool) -> float:
        """Collective thrust that may be held when the stream ends now, N: the weight in the air, none on the ground."""
        if not observation.armed:
            return 0.0
        if not flown:
            return 0.0 if observation.landed or not self.engagement.initially_armed else self._vehicle.weight
        match self.mission.policy.handler:
            case Handler.FLY:
                return self._vehicle.weight
            case Handler.SETTLE:
                return self._vehicle.weight if self._settling.cause else self.output.last_thrust
            case _:
                return 0.0

    def _send_last(self, observation: ObservationRecord, decision: Decision) -> None:
        if not observation.armed:
            self._parting.cancel()
        if self._parting.active:
            rate_body, decision.collective_thrust = self._parting.command(observation.time)
            self._finish(observation, decision, rate_body)

    def _finish(self, observation: ObservationRecord, decision: Decision, rate_body: Floats) -> None:
        held = self._held_thrust(observation, flown=self.engagement.flying or self._parting.active)
        if self.engagement.flying and not self.events.sinks:
            estimate, time = self._measured.estimate, observation.time
            rate_body = self.last_setpoint.replace(decision, rate_body, estimate, time, self.output)
            self._checks.pending |= self.last_setpoint.findings
        self.output.finish(decision, rate_body, held, observation.time)

    def _window(self, state: Floats, time: float) -> tuple[Floats, tuple[Floats, Floats]]:
        """The reference's state (13,) at this time, and what the next tick tracks: states and rotor speeds."""
        nodes = self.controllers.main.node_times(time + self._settings.period)
        states, inputs = self.mission.window(np.append(time, nodes), state[ATTITUDE])
        return states[0], (states[1:], inputs[1:-1])
