"""Setpoints that may be the last ones: which are checked before they leave, and what is said of it. Pure.

A process may die after any setpoint. PX4 then holds that setpoint for COM_OF_LOSS_T and lets its failsafe act;
docs/last_setpoint.md says what the check predicts, what it guarantees, and what it does not.
"""

from __future__ import annotations

from math import inf, radians

import numpy as np

from dynamics.arrays import Floats
from dynamics.own_effects import catalogue_of
from dynamics.rate_loop import ACTUATION_DELAY, modelled_motor_lag, motor_time_constant
from dynamics.state import VELOCITY
from dynamics.trim import FAR_FROM_GROUND
from runtime.control.controller import Controller
from runtime.control.rti.last_setpoint import CheckedSetpoint, LastSetpointCheck, LastSetpointModel, Outcome
from runtime.flight.decision import Decision, LastSetpointMode
from runtime.flight.events import Event, Fallback
from runtime.flight.mission import Mission
from runtime.flight.phases import Handler
from runtime.flight.plan_review import PlanReview
from runtime.flight.setpoint_output import SetpointOutput
from runtime.link.estimate import StateEstimate
from runtime.running_mean import RunningMean

LOSS_TIME = "COM_OF_LOSS_T"  # PX4's, s without a setpoint, after which its failsafe acts
USUAL_LOSS_TIME = 1.0  # s
SWITCHING = 0.12  # s from there until PX4 has changed its mode, measured
TRANSIT = 0.01  # s from an estimate's arrival to the setpoint's effect, beyond the rate loop's own delay
ATTITUDE_GAIN, ATTITUDE_RATE = 4.0, radians(220.0)  # PX4's MC_ROLL_P and MC_ROLLRATE_MAX
LAND_SPEED = 0.7  # m/s, MPC_LAND_SPEED
PATIENCE = 3.0  # s in which the failsafe brakes
EDGE = 0.1  # m that setpoints stay from the sides of the box
SPREAD = 0.15  # m/s by which a prediction errs more and more: an estimate's velocity and tilt
TOUCH_SPEED, TOUCH_UPRIGHT = 1.5, 0.85  # m/s and cosine of the tilt: a fall from 0.11 m, at 32 degrees
MIN_LAG = 0.01  # s, of body rates
MAX_DRAG, DRAG_SPEED, DRAG_TIME = 3.0, 2.0, 0.02  # 1/s; m/s and s of the prediction that shows it
# a loop that is throttled in nearly every tick swings or stands: a plan that passes is not all that a flight needs
REPLACED_TIME, MAX_REPLACED, MAX_TICK = 1.0, 0.7, 0.1  # s of a running mean, share of ticks, s that one counts at most
NOT_CHECKED = (Fallback.LEVEL_HOLD, Fallback.STOP_STREAMING)  # flown without an estimate


def last_setpoint_model(controller: Controller, nominal: Controller | None, loss_time: float) -> LastSetpointModel:
    """The check's model of a vehicle, beside its place. nominal: of the vehicle file's model beside a learned one.

    loss_time: the autopilot's COM_OF_LOSS_T, s.
    """
    trim, vehicle, options = controller.trim, controller.model.vehicle, controller.options
    catalogue = catalogue_of(vehicle)
    modelled = modelled_motor_lag(vehicle.effects, catalogue)
    tilt, yaw = options.rate_lookahead + modelled, options.yaw_lookahead + modelled
    model = LastSetpointModel(hold=loss_time + SWITCHING, mass=trim.body.mass, thrust_max=trim.thrust_limits[1])
    model.lag[:] = [max(lag, MIN_LAG) for lag in (tilt, tilt, yaw)]
    model.thrust_lag = motor_time_constant(vehicle.effects, catalogue) + ACTUATION_DELAY
    model.drag = linear_drag(nominal or controller)
    model.rate_max[:] = trim.limits.rate
    model.attitude_gain, model.attitude_rate_max = ATTITUDE_GAIN, ATTITUDE_RATE
    model.sink, model.patience = LAND_SPEED, PATIENCE
    model.edge, model.spread = EDGE, SPREAD
    model.low[:], model.high[:] = trim.limits.box or ([-inf] * 3, [inf] * 3)
    model.ground = -inf
    model.touch_speed, model.touch_upright = TOUCH_SPEED, TOUCH_UPRIGHT
    return model


def linear_drag(controller: Controller) -> float:
    """Deceleration over speed that a controller's model predicts of a level vehicle, 1/s; 0 of a learned model."""
    if controller.is_learned:
        return 0.0
    solver, model = controller.solver, controller.model
    state = model.initial_state(np.array([0.0, 0.0, FAR_FROM_GROUND, DRAG_SPEED, 0.0, 0.0, 1.0, *[0.0] * 6]))
    for place in solver.rotor_speed_places:
        state[place] = solver.trim.rotor_speed
    after = float(solver.propagate(state, solver.trim.rotor_speed, DRAG_TIME)[VELOCITY][0])
    return min(max((DRAG_SPEED - after) / (DRAG_SPEED * DRAG_TIME), 0.0), MAX_DRAG)


class LastSetpointGuard:
    """Replaces setpoints that must not be the last ones, in the phases in which the controller flies.

    mode: auto: not in a flight that is planned with such setpoints, nor on in one whose setpoints are replaced in most
        ticks of a second, which an event says; replace: always; off: never.
    findings: events of the last setpoint.
    """

    def __init__(
        self,
        controller: Controller,
        nominal: Controller | None,
        mission: Mission,
        mode: LastSetpointMode,
        loss_time: float,
    ) -> None:
        """loss_time: the autopilot's COM_OF_LOSS_T, s."""
        self.findings: dict[Event, str] = {}
        self._mode, self._mission, self._thrust_constant = mode, mission, controller.trim.rotors.thrust_constant
        self._exempt = self._given_up = False
        self._replaced, self._counted = RunningMean(REPLACED_TIME, 0.0), inf
        self._check: LastSetpointCheck | None = None
        self._review: PlanReview | None = None
        if mode != "off":
            model = last_setpoint_model(controller, nominal, loss_time)
            self._check = controller.solver.last_setpoint_check(model)
            self._review = PlanReview(self._check, self._thrust_constant) if mode == "auto" else None

    def look_ahead(self, state: Floats, *, standing: bool, flying: bool) -> dict[Event, str]:
        """Look at a part of the planned flight, once a tick's setpoint has left. Returns an event as of `begin`.

        state: (13,) of the vehicle, before control is taken its place of take-off. standing: whether on the ground.
        """
        if self._review is None or (flying and self._review.share is not None):
            return {}
        complete = self._review.go_on(self._mission, state, standing=standing)
        return self._judge() if complete and flying else {}

    def forget_plan(self) -> None:
        """The flight is over, or not to begin: the next one is looked at anew."""
        if self._review is not None:
            self._review.clear()

    def begin(self) -> dict[Event, str]:
        """Control is taken. Returns the event where the planned flight has setpoints that fail.

        A flight that was not looked at to its end before is checked until it is.
        """
        self._replaced, self._counted = RunningMean(REPLACED_TIME, 0.0), inf
        self._exempt = False
        return self._judge()

    def _judge(self) -> dict[Event, str]:
        if self._review is None or not self._review.share or self._check is None:
            return {}
        self._exempt = True
        share, hold = self._review.share, self._check.model.hold
        text = f"{share:.0%}, held for {hold:.1f} s, end outside of the box or at the ground"
        return {Event.LAST_SETPOINT_UNCHECKED: f"{text}: fly it higher, slower, or with a lower {LOSS_TIME}"}

    def planned(self, output: SetpointOutput) -> LastSetpointModel | None:
        """The model by which the next tick's setpoint is checked, None where it is not. output: knows the thrust."""
        if self._check is None or self._exempt:
            return None
        self._place(output)
        return self._check.model

    def _place(self, output: SetpointOutput) -> None:
        assert self._check is not None
        model = self._check.model
        model.ground, model.thrust_max = self._mission.ground, output.available_thrust

    def replace(
        self, decision: Decision, rate_body: Floats, estimate: StateEstimate | None, time: float, output: SetpointOutput
    ) -> Floats:
        """Check a decision's setpoint. Returns the body rates (3,) that may leave, rad/s; sets the decision's thrust.

        estimate: the newest. time: s, now. output: knows the thrust that acts and that there is.
        """
        self.findings, policy = {}, self._mission.policy
        if self._given_up:
            self.findings[Event.LAST_SETPOINT_UNCHECKED] = (
                "most were replaced for more than a second: it goes on without"
            )
            self._given_up = False
        if self._check is None or self._exempt or estimate is None or policy.handler is not Handler.FLY:
            return rate_body
        if decision.fallback in NOT_CHECKED:
            return rate_body
        self._place(output)
        age = time - estimate.time + TRANSIT
        checked = self._check.check(estimate.state, age, output.last_thrust, rate_body, decision.collective_thrust)
        self._count(checked.outcome is not Outcome.PASSES, time)
        if checked.outcome is Outcome.PASSES:
            return rate_body
        self.findings = self._describe(checked, rate_body, decision.collective_thrust)
        decision.collective_thrust = checked.collective_thrust
        return checked.rate_body

    def _count(self, replaced: bool, time: float) -> None:
        """In `auto`, leave a flight alone from the next tick on whose setpoints are replaced for so long."""
        self._replaced.add(float(replaced), min(max(time - self._counted, 0.0), MAX_TICK))
        self._counted = time
        if self._mode == "auto" and self._replaced.value > MAX_REPLACED:
            self._exempt, self._given_up = True, True

    def _describe(self, checked: CheckedSetpoint, rate_body: Floats, thrust: float) -> dict[Event, str]:
        if checked.outcome is Outcome.NONE_PASSES:
            return {
                Event.LAST_SETPOINT_UNSAFE: f"the least bad one leaves, {checked.harm:.1f} m outside or m/s of impact"
            }
        before, after = float(np.linalg.norm(rate_body)), float(np.linalg.norm(checked.rate_body))
        text = f"body rates {before:.1f} to {after:.1f} rad/s, thrust {thrust:.2f} to {checked.collective_thrust:.2f} N"
        return {Event.LAST_SETPOINT_REPLACED: f"{text}, else {checked.harm_given:.1f} m outside or m/s of impact"}
