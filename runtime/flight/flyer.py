"""One tick of the control thread as a pure object: observation and estimate in, setpoint, requests and changes out.

`step` is the urgent half, `prepare` follows once the setpoint has left. No clock, no input or output: the daemon feeds
it from the link, the replay from a recording, and both get the same setpoints.
"""

from __future__ import annotations

from math import degrees, inf, isnan, radians

import numpy as np

from dynamics import quaternion
from dynamics.arrays import Floats
from dynamics.decoding import decode_json
from dynamics.state import ATTITUDE, POSITION, VELOCITY
from dynamics.vehicle import Vehicle
from runtime.control.adaptation import Adaptation, FollowedValue
from runtime.control.controller import Command, Controller
from runtime.flight.attribution import Attribution
from runtime.flight.consistent_velocity import ConsistentVelocity
from runtime.flight.decision import Decision, Ending, FlyerSettings
from runtime.flight.engagement import AutopilotRequest, Engagement, Facts, State
from runtime.flight.events import POLICIES, Event, EventChange, EventMonitor, Fallback
from runtime.flight.failsafe import FallbackChain, LevelHold, level_rate
from runtime.flight.ground_contact import GroundContact
from runtime.flight.ground_probe import Ground
from runtime.flight.health import FlightHealth, FrozenEstimate
from runtime.flight.mission import Mission
from runtime.flight.parting import Parting
from runtime.flight.phases import Handler
from runtime.flight.settling import SHUTDOWN_TIME, Settling
from runtime.flight.shifted import ShiftedSolution
from runtime.flight.start_pose import StartPose
from runtime.flight.takeoff import HandOver, TakeoffRamp
from runtime.flight.thrust import EffectivenessEstimator, ThrustMap, specific_force_z, vertical
from runtime.link.estimate import StateEstimate
from runtime.record.records import ObservationRecord

ZERO_RATE = np.zeros(3)
FAILSAFE_TIME = 0.3  # s without a setpoint, after which an autopilot's failsafe may act (COM_OF_LOSS_T is not less)
STOPPED = "stopped streaming at once"
DISARM_PATIENCE = 10.0  # s until the autopilot is requested to land and disarm
DISARM_PERIOD = 0.5  # s between requests to disarm: PX4 refuses the first ones, until its own land detector agrees
STALE_SOLUTION = 0.2  # s without a solution after which the solver is reset
MAX_LEANING = radians(15.0)  # change of tilt on the ground that ends a take-off
LEVELLING_SHARE = 0.6  # of the weight, from which on a take-off levels: it would leave a slope sideways
START_GAIN, START_LIMIT = 3.0, 0.5  # 1/s and rad/s, of that
SINK_GAIN, SINK_LIMIT = 3.0, 2.0  # 1/s and rad/s, of levelling where thrust is lost
MIN_THRUST = 1.08  # of the weight, at most available, with which a flight goes on
SINK_SHARE = 0.95  # of the weight, thrust of a level hold while landing
CATCH_TIME = 0.15  # s in which the controller takes over after a false contact
_UNUSABLE = (Event.ESTIMATE_STALE, Event.ESTIMATE_FROZEN, Event.INPUT_NOT_FINITE, Event.CLOCK_BACKWARDS)


class Flyer:
    """The flight logic: engagement, mission phases, controller, fallbacks, thrust.

    motors: for each rotor the index of the autopilot's motor, None where it is not known.
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
    ) -> None:
        """nominal: controller of the vehicle file's model, the fallback of a learned one; None without one."""
        self.motors: tuple[int, ...] | None = None
        self.engagement = Engagement(settings.engagement)
        self.events = EventMonitor()
        self.mission = mission
        self.effectiveness = EffectivenessEstimator(vehicle.body.mass, settings.thrust)
        self._settings = settings
        self._vehicle = vehicle
        self._controller = controller
        self._nominal = nominal
        self._nominal_ready = False
        self._flying = controller
        self._thrust_map = thrust_map
        self._rate_limit = vehicle.limits.rate
        self._thrust_limit = vehicle.thrust_limits[1]
        self._sent: tuple[Floats, float, float, float] | None = None
        self._chain = FallbackChain(settings.bounds)
        self._health, self._frozen = FlightHealth(vehicle, settings.health), FrozenEstimate()
        self._hold = LevelHold(vehicle.weight)
        self._parting = Parting(self._hold, settings.period)
        response = settings.thrust.delay + settings.thrust.response_time
        self._ramp = TakeoffRamp(vehicle.weight, thrust_map.thrust_max, response_time=response)
        self._ground = GroundContact(vehicle, settings.period)
        self._start_pose = StartPose()
        self._settling = Settling(vehicle.weight, min(vehicle.limits.rate[:2]))
        self._ending = Ending()
        self._shifted = ShiftedSolution()
        self._hand_over: HandOver | None = None
        self._pending: dict[Event, str] = {}
        self._velocity = ConsistentVelocity()
        self._attribution = Attribution(settings.period)
        self._observed: ObservationRecord | None = None
        self._received: StateEstimate | None = None
        self._estimate: StateEstimate | None = None
        self._previous: StateEstimate | None = None
        self._force = np.full(3, np.nan)
        self._voltage = float("nan")
        self._solution: tuple[float, Command, Controller] | None = None
        self._failed: Controller | None = None
        self._state: Floats | None = None
        self._last_setpoint: tuple[Floats, float] = (ZERO_RATE, 0.0)
        self._last_disarm_request = -inf
        self._prepared = False
        self._last_solution = -inf

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
    def model_ratio(self) -> float:
        """A learned model's running error over its error in training; NaN where none flies."""
        return self._controller.fit_ratio

    @property
    def model_uncertainty(self) -> float:
        """Disagreement of a learned model's members over what one validation row in 100 exceeds; NaN without any."""
        return self._controller.uncertainty

    @property
    def network_share(self) -> float:
        """Share of a learned model's network that its predictions have; NaN where none flies."""
        return self._controller.network_share

    @property
    def adaptation(self) -> Adaptation | None:
        """Of the controller that flies, None where its model does not follow."""
        return self._flying.adaptation

    @property
    def followed(self) -> dict[str, FollowedValue]:
        """The parameters that the flying controller's model follows, and losses of rotors, by name."""
        values = {} if self.adaptation is None else dict(self.adaptation.values)
        return values | {name: value for each in self._adaptations for name, value in each.losses}

    @property
    def _adaptations(self) -> list[Adaptation]:
        controllers = (self._controller, self._nominal)
        return [each.adaptation for each in controllers if each is not None and each.adaptation is not None]

    @property
    def horizon(self) -> tuple[Floats, Floats] | None:
        """Predicted states (N + 1, nx) and rotor speeds (N, rotors) while the controller flies; views."""
        if not self._prepared:
            return None
        return self._controller.predicted_states, self._controller.predicted_inputs

    def step(self, observation: ObservationRecord, estimate: StateEstimate | None) -> Decision:
        """Decide what to send now. estimate: the newest accepted one, the same object while there is no newer."""
        decision = Decision()
        fresh = estimate is not self._received
        if observation.engage:
            decision.event_changes += self.events.rearm(observation.time)
            self.engagement.engage()
        self._received = estimate
        self._attribution.observe(observation.time, estimate, fresh=fresh)
        if estimate is not None:
            estimate = self._velocity.correct(estimate, moved=observation.reset) if fresh else self._estimate
        self._take_estimate(observation, estimate, fresh)
        decision.event_changes += self.events.update(self._findings(observation, estimate), observation.time)
        self._probe_ground(decision.event_changes, observation.time)
        decision.fallback = self._choose_fallback(observation.time)
        was_streaming, was_flying = self.engagement.streaming, self.engagement.flying
        self._engage(observation, decision)
        if self.engagement.streaming:
            self._parting.cancel()
            self._command(observation, decision)
        elif was_streaming:
            self._part(observation, decision, flown=was_flying)
        if not self.engagement.streaming:
            self._send_last(observation, decision)
            self._health.rest()
        return decision

    def prepare(self, time: float) -> None:
        """Advance the mission and linearise for the next tick, after the setpoint has left. time: s, of this tick."""
        self._read_rotors()
        self._remember_sent()
        if not self.engagement.flying or self._state is None or not self.mission.airborne:
            self._measure_force(time, None)
            self._prepared = False
            return
        self._after_departure(time)
        self.mission.update(self._state, time)
        reference, window = self._window(time)
        self._measure_force(time, reference)
        if time - self._last_solution > STALE_SOLUTION:
            self._controller.reset(self._state, time)
        if self._estimate is not None and self._nominal is not None and self._flying is self._nominal:
            self._controller.keep_warm(self._nominal, self._estimate.state, self._estimate.time, time)
        self._check_model(time)
        self._track_with_nominal(time)
        self._controller.prepare(*window)
        self._prepared = True
        if self._nominal is not None and self._nominal_ready:
            self._nominal.prepare(*window)

    def _track_with_nominal(self, time: float) -> None:
        """Keep the nominal controller ready while a learned model flies, and while an event requires a fallback.

        Before either is prepared, which moves their inputs to the next tick.
        """
        if self._nominal is None or (self.events.fallback is Fallback.NONE and not self._controller.is_learned):
            self._nominal_ready = False
            return
        # after a divergence the nominal controller starts from hover inputs, not from the diverged plan
        diverging = Event.MODEL_OSCILLATES in self._pending and Event.MODEL_OSCILLATES not in self.events.active
        if (diverging or not self._nominal_ready) and self._state is not None:
            self._nominal.reset(self._state, time)
        if not diverging and self._estimate is not None and self._flying is not self._nominal:
            self._nominal.keep_warm(self._controller, self._estimate.state, self._estimate.time, time)
        self._nominal_ready = True

    def _check_model(self, time: float) -> None:
        """Enter the reasons against flying a learned model at the next tick as events of that tick."""
        waiting, outside, unfit = self._controller.model_faults(time)
        if waiting:
            self._pending[Event.MODEL_WAITING] = waiting
        if outside:
            self._pending[Event.MODEL_OUTSIDE] = outside
        if unfit:
            self._pending[Event.MODEL_UNHEALTHY] = unfit
        if (adaptation := self._controller.adaptation) is not None:
            if changed := adaptation.changed:
                self._pending[Event.MODEL_CHANGED] = changed
            if adaptation.flies and (excess := adaptation.excess):
                self._pending[Event.PUSHED] = excess
            if refusal := adaptation.refusal:
                self._pending[Event.ADAPTATION_REFUSED] = refusal

    def reference_now(self, time: float) -> Floats | None:
        """The reference's state (13,) at a time, s; None when nothing is tracked."""
        if not self.mission.airborne or self._state is None:
            return None
        states, _ = self.mission.window(np.array([time]), self._state[ATTITUDE])
        return np.asarray(states[0])

    # --- observation

    def _take_estimate(self, observation: ObservationRecord, estimate: StateEstimate | None, fresh: bool) -> None:
        if observation.reset:
            self.mission.shift(observation.reset_position, observation.reset_yaw)
        self._force = np.append(observation.specific_force_xy, observation.specific_force_z)
        self._voltage = observation.battery_voltage if observation.battery_voltage > 0 else self._voltage
        self._previous, self._estimate = self._estimate, estimate
        self._observed = observation
        if estimate is not None and fresh:
            self._state = estimate.state
            if not self.engagement.flying:
                self._start_pose.add(estimate.state, observation.time, moved=observation.reset)
            if self._health.is_current(estimate, observation.time):
                self._hold.observe(estimate.attitude)

    def _read_rotors(self) -> None:
        """Take what the last observation had of the rotors."""
        observation, self._observed = self._observed, None
        if observation is None:
            return
        for adaptation in self._adaptations:
            adaptation.read_force(observation.time, observation.specific_force_z)
            if observation.rotor_speed.size and not self.mission.policy.lands:
                speed, measured = observation.rotor_speed, observation.rotors_measured
                adaptation.read_rotors(observation.rotor_time, speed, measured=measured)

    def _remember_sent(self) -> None:
        if self._sent is None:
            return
        rate_body, collective_thrust, thrust, time = self._sent
        self._sent = None
        self.effectiveness.command(self._thrust_map.collective_thrust(thrust), time)
        self._health.sent(rate_body, collective_thrust, time)
        if self._controller.adaptation is not None:
            effectiveness = self.effectiveness.value
            realised = self._thrust_map.collective_thrust(thrust, effectiveness)
            for controller in filter(None, (self._controller, self._nominal)):
                controller.sent(realised, time, effectiveness)

    def _after_departure(self, time: float) -> None:
        """The work that is not urgent: store the solution, check the flight, update the effectiveness."""
        if self._solution is not None:
            self._shifted.keep(*self._solution)
            self._solution = None
        now, previous = self._estimate, self._previous
        if now is None or now is previous:
            return
        self._pending |= self._health.flight(now.state, time, learned=self._controller.is_learned)
        force = float(self._force[2])
        if isnan(force) and previous is not None and now.time - previous.time > 1e-3:
            elapsed = now.time - previous.time
            force = specific_force_z(previous.velocity_world, now.velocity_world, elapsed, now.attitude)
        if self.adaptation is not None:
            force -= self.adaptation.specific_drag(now.state)
        landing, velocity = self.mission.policy.lands, now.velocity_world
        near = landing and self._ground.may_be_near(self.mission, now.state, reported_landed=False)
        climb = float(quaternion.rotate_inverse(now.attitude, velocity)[2])
        speed, sideways = float(np.linalg.norm(velocity)), (float(self._force[0]), float(self._force[1]))
        self.effectiveness.measure(force, now.time, speed, climb=climb, sideways=sideways, landing=near)
        pushed = self._vehicle.body.mass * float(np.linalg.norm(self.effectiveness.across))
        if (left := (self._available_thrust + pushed) / self._vehicle.weight) < MIN_THRUST:
            self._pending[Event.THRUST_LOST] = f"at most {left:.2f} of the weight"
        if self.adaptation is not None and not landing:
            self.adaptation.read_voltage(now.time, self._voltage, self.effectiveness.value)

    @property
    def _available_thrust(self) -> float:
        """The greatest collective thrust by the present effectiveness, N."""
        return min(self._thrust_limit, self.effectiveness.value * self._thrust_map.thrust_max)

    def _measure_force(self, time: float, reference: Floats | None) -> None:
        """Update the external force, and the events that it shows. reference: state (13,) at this time, or None."""
        estimate = self._estimate
        if not self.engagement.flying or estimate is None or not self.mission.policy.leaves_ground:
            self._ground.clear()
            return
        thrust = self.effectiveness.thrust(time) / self._vehicle.body.mass
        missing = thrust * (self.effectiveness.initial / self.effectiveness.value - 1)
        self._pending |= self._ground.measure(
            self.mission, estimate, reference, self._force, thrust, time, missing_thrust=missing
        )

    def _findings(self, observation: ObservationRecord, estimate: StateEstimate | None) -> dict[Event, str]:
        present, self._pending = self._pending, {}
        if observation.findings:
            present |= {Event(name): text for name, text in decode_json(observation.findings).items()}
        present |= self._health.estimate_age(estimate, observation.time)
        if self._received is not None:
            present |= self._frozen.update(self._received, self._force)
        for adaptation in self._adaptations:
            present |= self._rotor_findings(adaptation)
        if not self.engagement.flying and not self.engagement.initially_armed:
            present |= self._start_pose.findings()
        if self.engagement.flying and not self.mission.policy.may_disarm:
            if not observation.armed:
                present[Event.DISARMED] = f"in phase {self.mission.phase.value}"
            elif not observation.offboard:
                present[Event.MODE_CHANGED] = f"to {observation.mode}"
                if (stood_still := self._attribution.standstill) > FAILSAFE_TIME:
                    present[Event.MODE_CHANGED] += f", after this computer stood still for {stood_still:.1f} s"
        return self._attribution.attribute(present) if self.engagement.flying else present

    def _rotor_findings(self, adaptation: Adaptation) -> dict[Event, str]:
        """Rotors that have lost thrust, or have a load under them: both take the same force at the same place away.

        Beyond the limit only where the model's changes are flown.
        """
        if adaptation.rotors is None or not (losses := adaptation.rotors.losses):
            return {}
        text = "; ".join(
            f"{self._rotor_name(loss.rotor)} has lost {100 * loss.share:.0f} +- {196 * loss.deviation:.0f} % of thrust"
            f", or a load of {adaptation.load_of(loss):.2g} kg hangs under it"
            for loss in losses
        )
        present = {Event.ROTOR_WEAK: text}
        return {**present, Event.ROTOR_FAILING: text} if adaptation.rotors.grave and adaptation.flies else present

    def _rotor_name(self, rotor: int) -> str:
        """The rotor's number in the vehicle file, and the autopilot's, from 1."""
        return f"rotor {rotor}" if self.motors is None else f"rotor {rotor} (motor {self.motors[rotor] + 1})"

    def _choose_fallback(self, time: float) -> Fallback:
        if not self.engagement.flying:
            return self.events.fallback
        if not self.mission.policy.falls_back:
            return Fallback.NONE
        active = self.events.active
        if Event.ESTIMATE_STALE in active and self._estimate and self._health.is_current(self._estimate, time):
            active = {event: detail for event, detail in active.items() if event is not Event.ESTIMATE_STALE}
        failed = (self._failed or self._controller) if Event.SOLVER_FAILED in active else None
        model = self._nominal or self._controller
        diverges = Event.MODEL_OSCILLATES in active and self._shifted.controller is self._controller
        chosen = self._chain.choose(
            active,
            time=time,
            estimate_usable=self._state is not None and not any(event in active for event in _UNUSABLE),
            solution_left=not self.mission.airborne or (self._shifted.reaches(time) and not diverges),
            nominal_available=failed is not model and (self._nominal_ready or self._nominal is None),
        )
        # without a learned model the vehicle file's model flies already
        return Fallback.NONE if chosen is Fallback.NOMINAL_MODEL and self._nominal is None else chosen

    # --- engagement

    def _engage(self, observation: ObservationRecord, decision: Decision) -> None:
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
            fallback=decision.fallback,
            reason=self._chain.reason if was_flying else self.events.reason,
        )
        decision.transitions += self.engagement.update(facts, observation.time)
        decision.requests = self.engagement.requests
        if observation.stop:
            decision.transitions += self.engagement.release(STOPPED, observation.time)
        if self.engagement.state is State.ENGAGED and not was_flying:
            self._begin(observation)
        if self.engagement.flying and self._state is not None:
            if observation.leave:
                self.mission.land(observation.leave, self._state, observation.time)
            elif self.events.landing_reason:
                self._land(self.events.landing_reason, observation.time)
        elif observation.leave:
            decision.transitions += self.engagement.release(observation.leave, observation.time)

    def _begin(self, observation: ObservationRecord) -> None:
        """Start to fly after control was taken: from the ground by the ramp, in the air at once."""
        if self._state is None:
            return
        if observation.landed or not self.engagement.initially_armed:
            self.mission.ramp(self._start_pose.median(self._state), observation.time)
        else:
            self.mission.take_over(self._state, observation.time)
            self._start_controller(observation.time)

    def _start_controller(self, time: float) -> None:
        assert self._state is not None
        for controller in (self._controller, self._nominal):
            if controller is not None:
                controller.reset(self._state, time)
        self._prepared, self._last_solution = False, time

    def _land(self, reason: str, time: float) -> None:
        """Cut the flight short after an event, or a take-off before it leaves the ground."""
        assert self._state is not None
        if self.mission.policy.handler is Handler.TAKE_OFF:
            self._ending.not_flown = reason
        self.mission.land(reason, self._state, time)
        if self.events.sinks:
            self.mission.sink(self._state, time)

    # --- setpoint

    def _command(self, observation: ObservationRecord, decision: Decision) -> None:
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
            decision.rate_body, decision.collective_thrust = ZERO_RATE, 0.0

    def _hold_level(self, decision: Decision) -> None:
        decision.rate_body, decision.collective_thrust = self._hold.command(self._settings.period)
        if self.mission.policy.lands:
            decision.collective_thrust *= SINK_SHARE

    def _take_off(self, observation: ObservationRecord, decision: Decision) -> None:
        assert self._state is not None
        decision.rate_body = ZERO_RATE
        if decision.fallback >= Fallback.LEVEL_HOLD:
            self._land(self._chain.reason, observation.time)
            return
        height, climb_rate = float(self._state[POSITION][2]), float(self._state[VELOCITY][2])
        force = vertical(self._force, self._state[ATTITUDE])
        decision.collective_thrust = self._ramp.update(observation.time, height, climb_rate, force)
        if decision.collective_thrust > LEVELLING_SHARE * self._vehicle.weight:
            decision.rate_body = level_rate(self._state[ATTITUDE], gain=START_GAIN, limit=START_LIMIT)
        if self._ramp.failed:
            self._pending[Event.TAKEOFF_FAILED] = (
                f"at {self._ramp.collective_thrust:.2f} N; is it held, or a propeller missing?"
            )
        if (leaning := self._start_pose.leaning(self._state)) > MAX_LEANING:
            self._pending[Event.TIPPING] = f"by {degrees(leaning):.0f} degrees since the motors started"
        if not self._ramp.lifted:
            return
        self.effectiveness.start(self._ramp.effectiveness)
        self._hand_over = HandOver(observation.time, self._ramp.collective_thrust * self.effectiveness.value)
        self.mission.climb(self._state, observation.time)
        self._start_controller(observation.time)
        decision.collective_thrust = self._hand_over.collective_thrust

    def _shut_down(self, observation: ObservationRecord, decision: Decision) -> None:
        since = observation.time - self.mission.phase_started
        decision.rate_body = ZERO_RATE
        decision.collective_thrust = self._settling.shut_down(since, self._last_setpoint[1])
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
        if cause is None or not self.engagement.flying or not self.mission.airborne or self._state is None:
            return
        self.mission.land(cause.text, self._state, time)
        self._take_thrust_away(time, cause.text)

    def _take_thrust_away(self, time: float, cause: str = "") -> None:
        """cause: event after which the ground is probed in flight; empty in a landing."""
        assert self._state is not None
        self._settling.begin(self._state, self._last_setpoint[1], time, cause=cause)
        self.mission.settle(self._state, time)

    def _settle(self, observation: ObservationRecord, decision: Decision) -> None:
        """Level, with thrust going away, until the ground is known to carry the vehicle or not to be there."""
        assert self._state is not None
        time, ground, state = observation.time, self._ground, self._state
        usable = not any(event in self.events.active for event in _UNUSABLE)
        current = usable and self._estimate is not None and self._health.is_current(self._estimate, time)
        low = ground.may_be_near(self.mission, state, reported_landed=observation.landed)
        decision.rate_body, decision.collective_thrust, verdict = self._settling.command(
            state, ground.meter, time, current=current, low=low
        )
        match verdict:
            case Ground.CARRIES:
                if cause := self._settling.cause or ground.blow:
                    self._ending.crashed = self._pending[Event.CRASHED] = cause
                self.mission.shut_down(state, time)
            case Ground.ABSENT:
                self._pending[Event.CONTACT_LOST] = ""
                self._hand_over = HandOver(time, decision.collective_thrust, CATCH_TIME)
                self.mission.catch(state, time)
                self._start_controller(time)
            case Ground.OPEN:
                pass

    def _fly(self, observation: ObservationRecord, decision: Decision) -> None:
        command = self._solve(observation.time, decision)
        if command is not None:
            decision.rate_body, decision.collective_thrust = command
        elif decision.fallback is Fallback.SHIFTED_SOLUTION and self._shifted.reaches(observation.time):
            decision.rate_body, decision.collective_thrust = self._shifted.at(observation.time)
        elif not self._prepared and self._hand_over is not None:
            decision.rate_body, decision.collective_thrust = ZERO_RATE, self._hand_over.collective_thrust
        else:
            decision.fallback = max(decision.fallback, Fallback.LEVEL_HOLD)
            decision.rate_body, decision.collective_thrust = self._hold.command(self._settings.period)
        if self.events.sinks and self._state is not None:
            # thrust stays the controller's, which takes all that there is while the vehicle sinks too fast
            decision.rate_body = level_rate(self._state[ATTITUDE], gain=SINK_GAIN, limit=SINK_LIMIT)
        elif (limit := self.mission.policy.tilt_rate) < inf:
            decision.rate_body[:2] = np.clip(decision.rate_body[:2], -limit, limit)
        if self._hand_over is not None:
            decision.collective_thrust = self._hand_over.blend(decision.collective_thrust, observation.time)

    def _solve(self, time: float, decision: Decision) -> tuple[Floats, float] | None:
        """Rates and thrust of a fresh solution; None when there is none or it may not be flown."""
        assert self._estimate is not None
        if decision.fallback is Fallback.SHIFTED_SOLUTION or not self._prepared:
            return None
        falls_back = decision.fallback is Fallback.NOMINAL_MODEL and self._nominal is not None and self._nominal_ready
        controller = self._nominal if falls_back and self._nominal is not None else self._controller
        state = controller.compensate(self._estimate.state, self._estimate.time, time)
        command = controller.feedback(state, time)
        decision.solver_status, decision.feedback_seconds = command.status, command.seconds
        if command.fault:
            self._pending[Event.SOLVER_FAILED], self._failed = command.fault, controller
            decision.fallback = self._chain.replace_solution(Event.SOLVER_FAILED, command.fault)
            return None
        self._solution, self._flying = (time, command, controller), controller
        self._last_solution = time
        return command.rate_body, command.collective_thrust

    def _look_for_ground(self, observation: ObservationRecord, collective_thrust: float) -> None:
        """Take thrust away once a landing has reached the ground."""
        if self._state is None:
            return
        policy, time, reported = self.mission.policy, observation.time, observation.landed
        if self._ground.has_landed(policy, self._state, collective_thrust, time, reported_landed=reported):
            self._take_thrust_away(time)
        else:
            self._pending |= self._ground.missing_ground(time)

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
                return self._vehicle.weight if self._settling.cause else self._last_setpoint[1]
            case _:
                return 0.0

    def _send_last(self, observation: ObservationRecord, decision: Decision) -> None:
        if not observation.armed:
            self._parting.cancel()
        if self._parting.active:
            rate_body, decision.collective_thrust = self._parting.command(observation.time)
            self._finish(observation, decision, rate_body)

    def _finish(self, observation: ObservationRecord, decision: Decision, rate_body: Floats) -> None:
        """Clip the setpoint to the vehicle's limits and convert its thrust to the autopilot's 0..1."""
        limited = zip(rate_body.tolist(), self._rate_limit, strict=True)
        decision.rate_body = np.array([min(max(rate, -limit), limit) for rate, limit in limited])
        decision.collective_thrust = min(max(decision.collective_thrust, 0.0), self._thrust_limit)
        decision.thrust = self._thrust_map.setpoint(decision.collective_thrust, self.effectiveness.value)
        held = self._held_thrust(observation, flown=self.engagement.flying or self._parting.active)
        decision.held_thrust = self._thrust_map.setpoint(held, self.effectiveness.value)
        self._last_setpoint = (decision.rate_body, decision.collective_thrust)
        self._sent = (decision.rate_body, decision.collective_thrust, decision.thrust, observation.time)

    def _window(self, time: float) -> tuple[Floats, tuple[Floats, Floats]]:
        """The reference's state (13,) at this time, and what the next tick tracks: states and rotor speeds."""
        assert self._state is not None
        nodes = self._controller.node_times(time + self._settings.period)
        states, inputs = self.mission.window(np.append(time, nodes), self._state[ATTITUDE])
        return states[0], (states[1:], inputs[1:-1])
