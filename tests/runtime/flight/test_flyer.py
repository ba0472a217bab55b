"""The whole flight logic in lockstep with a vehicle: it flies, and every fault ends in a safe state with a name."""

from __future__ import annotations

from dataclasses import replace

import msgspec
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from dynamics import quaternion
from dynamics.state import ATTITUDE
from dynamics.vehicle import Vehicle
from dynamics.vehicle_file import read_vehicle
from runtime.control.adaptation_settings import AdaptationSettings
from runtime.control.controller import Command, Controller, ControllerOptions
from runtime.control.rotor_loss import RotorLoss
from runtime.control.rti.solver import CUT
from runtime.flight.decision import FlyerSettings
from runtime.flight.engagement import AutopilotRequest, EngagementSettings, State
from runtime.flight.events import Event, Fallback
from runtime.flight.mission import Plan
from runtime.flight.motion import Transfer
from runtime.flight.phases import Phase
from tests.support.px4_estimate import Px4Estimate
from tests.support.rate_controlled_vehicle import Flight

PLAN = Plan(height=1.0, speed=2.5, acceleration=4.0, settle=0.3)
FULL = [
    Phase.GROUND,
    Phase.RAMP,
    Phase.CLIMB,
    Phase.APPROACH,
    Phase.TRACK,
    Phase.RETURN,
    Phase.DESCEND,
    Phase.TOUCHDOWN,
    Phase.CONTACT,
    Phase.SHUTDOWN,
]


@pytest.fixture(scope="module")
def vehicle() -> Vehicle:
    return read_vehicle("vehicles/arpl_250g.toml")


@pytest.fixture(scope="module")
def controller(vehicle: Vehicle) -> Controller:
    return Controller.build(vehicle)


@pytest.fixture(autouse=True, params=["exact", pytest.param("px4", marks=pytest.mark.slow)])
def estimate(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """Whose errors the estimate has: every test here flies on PX4's as well."""
    name = str(request.param)
    if name == "px4":
        monkeypatch.setattr(Flight, "estimator", lambda _: Px4Estimate(seed=7))
    return name


def prepare(vehicle: Vehicle, controller: Controller, **options: object) -> Flight:
    controller.reset(np.array([*[0.0] * 6, 1.0, *[0.0] * 6]), 0.0)
    reference = Transfer(vehicle, np.array([1.0, 0.0, 1.5, 0.0]), np.array([-1.0, 0.5, 1.5, 0.5]), 3.0)
    return Flight(vehicle, controller, reference, **{"plan": PLAN, **options})  # type: ignore[arg-type]


def upright(flight: Flight) -> float:
    return float(quaternion.rotate(flight.plant.state[ATTITUDE], [0.0, 0.0, 1.0])[2])


@pytest.mark.parametrize("effectiveness", [0.8, 1.0, 1.2])
def test_it_takes_off_tracks_and_lands_whatever_the_vehicle_really_weighs(
    vehicle: Vehicle, controller: Controller, effectiveness: float, estimate: str
) -> None:
    flight = prepare(vehicle, controller, effectiveness=effectiveness)
    story = flight.run(40.0)
    assert story.phases == FULL
    assert story.after == [State.STANDBY, State.STREAMING, State.ENGAGED, State.STANDBY]
    assert story.transitions[-1].reason == "landed and disarmed"
    assert np.sqrt(np.mean(np.square(story.errors))) < (0.06 if estimate == "exact" else 0.15)
    assert story.raised <= {Event.ESTIMATE_STALE}
    assert flight.flyer.over
    assert flight.plant.on_ground
    assert flight.flyer.effectiveness.value == pytest.approx(effectiveness, abs=0.06)


def test_lift_off_and_hand_over_leave_no_bump(vehicle: Vehicle, controller: Controller) -> None:
    flight = prepare(vehicle, controller, effectiveness=0.85, plan=Plan())
    flight.run(10.0, until=Phase.CLIMB)
    start = len(flight.story.decisions) - 1
    flight.run(1.0)
    decisions = flight.story.decisions[start - 20 :]
    collective_thrust = np.array([decision.collective_thrust for decision in decisions[20:]])
    thrust = np.array([decision.thrust for decision in decisions])
    assert np.max(np.abs(np.diff(collective_thrust))) < 0.1 * vehicle.weight
    assert np.max(np.abs(np.diff(thrust))) < 0.05
    heights = np.array([state[2] for state in flight.story.states[start:]])
    assert np.max(heights) < 0.8


def test_nothing_is_sent_before_engaging_is_requested(vehicle: Vehicle, controller: Controller) -> None:
    flight = prepare(vehicle, controller)
    flight.engage = False
    story = flight.run(3.0)
    assert all(decision.rate_body is None and not decision.requests for decision in story.decisions)


def test_nothing_is_streamed_to_a_vehicle_armed_before(vehicle: Vehicle, controller: Controller) -> None:
    flight = prepare(vehicle, controller)
    flight.armed, flight.mode = True, "OFFBOARD"
    story = flight.run(3.0)
    assert all(decision.rate_body is None for decision in story.decisions)
    assert "--resume" in flight.flyer.engagement.refusal
    assert flight.flyer.over


def test_with_resume_it_takes_over_in_the_air(vehicle: Vehicle, controller: Controller) -> None:
    flight = prepare(vehicle, controller, settings=FlyerSettings(engagement=EngagementSettings(resume=True)))
    flight.armed, flight.plant.force = True, vehicle.weight
    flight.plant.state[0:6] = [0.0, 0.0, 3.0, 0.5, 0.0, 0.0]
    flight.held_until_offboard = True
    story = flight.run(40.0)
    assert story.phases == [
        Phase.GROUND,
        Phase.BRAKE,
        Phase.APPROACH,
        Phase.TRACK,
        Phase.RETURN,
        Phase.DESCEND,
        Phase.TOUCHDOWN,
        Phase.CONTACT,
        Phase.SHUTDOWN,
    ]
    heights = np.array([state[2] for state in story.states])
    assert np.min(heights[: story.phases.index(Phase.TRACK) + 300]) > 1.0


def test_refused_arming_ends_in_standby_with_the_reason(vehicle: Vehicle, controller: Controller) -> None:
    flight = prepare(vehicle, controller)
    flight.grants = {AutopilotRequest.OFFBOARD}
    story = flight.run(15.0)
    assert story.after[-1] is State.STANDBY
    assert "did not show arming" in flight.flyer.engagement.refusal
    assert flight.flyer.over
    assert flight.plant.on_ground


def tracking(vehicle: Vehicle, controller: Controller) -> Flight:
    flight = prepare(vehicle, controller)
    flight.run(30.0, until=Phase.TRACK)
    flight.run(0.5)
    assert flight.flyer.engagement.state is State.ENGAGED
    return flight


def test_a_short_gap_of_estimates_is_flown_through(vehicle: Vehicle, controller: Controller) -> None:
    flight = tracking(vehicle, controller)
    flight.frozen = True
    flight.run(0.12)
    assert flight.flyer.engagement.state is State.FALLBACK
    flight.frozen = False
    flight.run(40.0)
    assert Event.ESTIMATE_STALE in flight.story.raised
    assert flight.story.phases == FULL
    assert max(flight.story.errors) < 0.3


def test_estimates_that_stop_lead_through_the_fallbacks_to_silence(vehicle: Vehicle, controller: Controller) -> None:
    flight = tracking(vehicle, controller)
    start = len(flight.story.decisions)
    flight.frozen = True
    flight.run(1.0)
    assert upright(flight) > 0.97
    flight.run(2.0)
    fallbacks = [decision.fallback for decision in flight.story.decisions[start:]]
    order = list(dict.fromkeys(fallbacks))
    assert order[:3] == [Fallback.NONE, Fallback.SHIFTED_SOLUTION, Fallback.LEVEL_HOLD]
    assert flight.story.decisions[-1].rate_body is None
    assert flight.story.after[-1] is State.STANDBY
    assert "failsafe" in flight.story.transitions[-1].reason
    # the estimates come back, engaging is not requested: nothing is sent
    flight.frozen = False
    flight.run(3.0)
    assert flight.story.decisions[-1].rate_body is None


def test_a_slipped_clock_is_not_compensated_but_fallen_back_from(vehicle: Vehicle, controller: Controller) -> None:
    flight = tracking(vehicle, controller)
    flight.slip = 0.3
    flight.run(0.5)
    assert flight.flyer.engagement.state is State.FALLBACK
    assert "old" in flight.story.transitions[-1].reason
    assert upright(flight) > 0.95
    flight.slip = 0.0
    story = flight.run(40.0)
    assert story.phases == FULL


@pytest.mark.parametrize("event", [Event.INPUT_NOT_FINITE, Event.ESTIMATE_JUMP, Event.CLOCK_BACKWARDS])
def test_a_doubted_estimate_is_not_followed(vehicle: Vehicle, controller: Controller, event: Event) -> None:
    flight = tracking(vehicle, controller)
    flight.findings, flight.frozen = {event.value: "as planted"}, True  # the link withholds what it rejects
    flight.run(0.08)
    assert flight.flyer.engagement.state is State.FALLBACK
    assert "as planted" in flight.story.transitions[-1].reason
    flight.findings, flight.frozen = {}, False
    story = flight.run(40.0)
    assert story.phases == FULL
    assert max(story.errors) < 0.3


def test_an_estimator_reset_moves_the_reference_along(vehicle: Vehicle, controller: Controller, estimate: str) -> None:
    flight = tracking(vehicle, controller)
    flight.offset = flight.reset = np.array([2.0, -1.0, 0.4])
    flight.findings = {Event.ESTIMATOR_RESET.value: "2.3 m"}
    flight.run(0.02)
    flight.findings = {}
    story = flight.run(40.0)
    assert story.phases == FULL
    assert max(story.errors) < 0.3
    drift = 0.0 if estimate == "exact" else 0.7  # that an estimate may have gone meanwhile, m
    assert np.linalg.norm(flight.plant.state[0:2]) < 0.3 + drift


def test_the_pilot_s_mode_switch_is_respected(vehicle: Vehicle, controller: Controller) -> None:
    flight = tracking(vehicle, controller)
    flight.mode = "POSCTL"
    switched = len(flight.story.decisions)
    flight.run(0.1)
    assert flight.story.decisions[-1].rate_body is None
    last = [decision.rate_body for decision in flight.story.decisions[switched:] if decision.rate_body is not None]
    assert not np.any(last)  # still ones, for a pilot who returns to OFFBOARD within COM_OF_LOSS_T
    assert Event.MODE_CHANGED in flight.story.raised
    flight.mode = "OFFBOARD"
    flight.run(1.0)
    assert flight.story.decisions[-1].rate_body is None
    assert flight.flyer.over


def test_an_interrupt_lands_and_disarms(vehicle: Vehicle, controller: Controller) -> None:
    flight = tracking(vehicle, controller)
    flight.leave = "SIGINT"
    story = flight.run(20.0)
    assert story.phases[-5:] == [Phase.BRAKE, Phase.DESCEND, Phase.TOUCHDOWN, Phase.CONTACT, Phase.SHUTDOWN]
    assert story.transitions[-1].reason == "landed and disarmed"
    assert not flight.armed


def test_an_interrupt_before_take_off_engages_nothing(vehicle: Vehicle, controller: Controller) -> None:
    flight = prepare(vehicle, controller)
    flight.run(0.5)
    flight.leave = "SIGINT"
    flight.run(1.0)
    assert flight.flyer.over
    assert not flight.armed


def test_a_vehicle_that_cannot_lift_itself_is_not_forced(vehicle: Vehicle, controller: Controller) -> None:
    flight = prepare(vehicle, controller, effectiveness=0.4)
    story = flight.run(15.0)
    assert Event.TAKEOFF_FAILED in story.raised
    assert story.after[-1] is State.STANDBY
    assert not flight.armed


def test_leaving_the_box_a_little_lands_and_leaving_it_far_gives_up(vehicle: Vehicle, controller: Controller) -> None:
    flight = tracking(vehicle, controller)
    flight.findings = {Event.GEOFENCE.value: "0.3 m outside of the box"}
    story = flight.run(20.0)
    assert story.phases[-1] is Phase.SHUTDOWN
    assert "outside of the box" in flight.flyer.mission.landing_reason
    far = tracking(vehicle, controller)
    far.findings = {Event.GEOFENCE_LEFT.value: "2.5 m outside of the box"}
    far.run(1.0)  # levelling and some still setpoints come last
    assert far.story.decisions[-1].rate_body is None


def test_an_autopilot_that_disarms_first_has_landed_us_all_the_same(vehicle: Vehicle, controller: Controller) -> None:
    flight = prepare(vehicle, controller)
    flight.run(40.0, until=Phase.TOUCHDOWN)
    flight.run(0.2)
    flight.armed = False
    flight.run(0.02)
    assert flight.flyer.landed
    assert flight.story.transitions[-1].reason == "landed and disarmed"
    assert Event.DISARMED not in flight.story.raised


def test_a_disarm_that_is_refused_is_left_to_the_autopilot(vehicle: Vehicle, controller: Controller) -> None:
    flight = prepare(vehicle, controller)
    flight.grants = {AutopilotRequest.OFFBOARD, AutopilotRequest.ARM, AutopilotRequest.LAND}
    story = flight.run(40.0)
    assert flight.mode == "LAND"
    assert "left to the autopilot" in story.transitions[-1].reason


def test_the_same_observations_give_the_same_setpoints_bit_for_bit(vehicle: Vehicle) -> None:
    first = prepare(vehicle, Controller.build(vehicle))
    first.run(12.0)
    second = prepare(vehicle, Controller.build(vehicle))
    for (observation, estimate), then in zip(first.story.observations, first.story.decisions, strict=True):
        decision = second.flyer.step(observation, estimate)
        second.flyer.prepare(observation.time)
        assert decision.thrust == then.thrust
        if then.rate_body is not None:
            assert decision.rate_body is not None
            np.testing.assert_array_equal(decision.rate_body, then.rate_body)


class Watched:
    """A controller that counts its solutions and fails on demand, and is the real one otherwise."""

    def __init__(self, real: Controller) -> None:
        self._real = real
        self.fails, self.cuts, self.solutions = False, False, 0

    def __getattr__(self, name: str) -> object:
        return getattr(self._real, name)

    def feedback(self, state: np.ndarray, time: float) -> Command:
        self.solutions += 1
        command = self._real.feedback(state, time)
        if self.cuts:
            return replace(command, status=CUT)
        return replace(command, status=3, rate_body=command.rate_body * np.nan) if self.fails else command


def test_a_model_that_stopped_fitting_is_replaced_by_the_nominal_one(vehicle: Vehicle, controller: Controller) -> None:
    nominal = Watched(Controller.build(vehicle))
    flight = prepare(vehicle, controller, nominal=nominal)
    flight.run(30.0, until=Phase.TRACK)
    assert nominal.solutions == 0
    flight.findings = {Event.MODEL_UNHEALTHY.value: "5 times the training error"}
    flight.run(0.6)
    assert flight.flyer.engagement.state is State.FALLBACK
    story = flight.run(40.0)
    assert nominal.solutions > 500
    assert story.phases == FULL
    assert max(story.errors) < 0.3


class Swinging:
    """A learned model's controller whose body rates alternate from tick to tick."""

    is_learned = True

    def __init__(self, real: Controller, swing: float) -> None:
        self._real, self.swing = real, swing

    def __getattr__(self, name: str) -> object:
        return getattr(self._real, name)

    def feedback(self, state: np.ndarray, time: float) -> Command:
        command, self.swing = self._real.feedback(state, time), -self.swing
        self._real.solver.inputs[:, ::2] *= 1 + 0.5 * self.swing  # its plan diverges with its commands
        return replace(command, rate_body=command.rate_body + np.array([self.swing, 0.0, 0.0]))


def swinging(vehicle: Vehicle, swing: float) -> Flight:
    learned = Swinging(Controller.build(vehicle), swing)
    return prepare(vehicle, learned, nominal=Controller.build(vehicle))  # type: ignore[arg-type]


def test_a_learned_model_that_makes_the_vehicle_oscillate_is_replaced_for_the_rest_of_the_flight(
    vehicle: Vehicle,
) -> None:
    flight = swinging(vehicle, 0.6)
    story = flight.run(60.0)
    assert story.phases == FULL
    oscillations = [change for change in story.event_changes if change.event is Event.MODEL_OSCILLATES]
    assert [change.active for change in oscillations] == [True]
    assert "from tick to tick" in oscillations[0].text
    first = story.times.index(oscillations[0].time)
    later = [decision for decision in story.decisions[first:] if decision.solver_status == 0]
    assert {decision.fallback for decision in later} == {Fallback.NOMINAL_MODEL}
    rates = np.array([decision.rate_body for decision in later[:50]])
    assert np.abs(np.diff(rates, axis=0)).max() < 0.4  # 0.5 where the nominal model starts from the other's plan
    assert max(story.errors) < 0.3
    again = swinging(vehicle, 0.6).flyer
    for (observation, estimate), before in zip(story.observations, story.decisions, strict=True):
        decision = again.step(observation, estimate)
        again.prepare(observation.time)
        np.testing.assert_array_equal(decision.rate_body, before.rate_body)
        assert (decision.thrust, decision.fallback) == (before.thrust, before.fallback)


def test_a_learned_model_flies_on_with_setpoints_as_rough_as_healthy_ones_become(vehicle: Vehicle) -> None:
    story = swinging(vehicle, 0.15).run(60.0)  # alternates by 0.6 rad/s, as the roughest fast flight measured
    assert story.phases == FULL
    assert Event.MODEL_OSCILLATES not in story.raised


def test_a_solver_that_fails_for_a_moment_is_bridged_and_one_that_stays_so_is_left(
    vehicle: Vehicle, controller: Controller
) -> None:
    failing = Watched(controller)
    flight = prepare(vehicle, failing)  # type: ignore[arg-type]
    flight.run(30.0, until=Phase.TRACK)
    failing.fails = True
    flight.run(0.06)
    failing.fails = False
    flight.run(0.5)
    assert Event.SOLVER_FAILED in flight.story.raised
    assert flight.flyer.engagement.state is State.ENGAGED
    assert max(flight.story.errors) < 0.2
    failing.fails = True
    flight.run(3.0)
    assert flight.story.after[-1] is State.STANDBY
    assert flight.story.decisions[-1].rate_body is None


def test_a_solver_that_is_cut_short_says_so_and_flies_on(vehicle: Vehicle, controller: Controller) -> None:
    cutting = Watched(controller)
    flight = prepare(vehicle, cutting)  # type: ignore[arg-type]
    flight.run(30.0, until=Phase.TRACK)
    assert Event.SOLVER_CUT not in flight.story.raised
    cutting.cuts = True
    flight.run(0.5)
    assert Event.SOLVER_CUT in flight.story.raised
    assert flight.flyer.engagement.state is State.ENGAGED
    assert flight.story.decisions[-1].solver_status == CUT
    assert max(flight.story.errors) < 0.2


def gaps(flight: Flight, seconds: float, findings: dict[str, str], count: int = 3) -> list[Fallback]:
    """Fallbacks over some gaps of the estimates, the age of the last one being 20 ms; `findings` in between as well."""
    flight.findings = findings
    flight.run(0.6)
    start = len(flight.story.decisions)
    for _ in range(count):
        flight.frozen = True
        flight.run(seconds)
        flight.frozen = False
        flight.run(0.1)
    return [decision.fallback for decision in flight.story.decisions[start:]]


@pytest.mark.parametrize("event", [Event.DEADLINES_MISSED, Event.MODEL_UNHEALTHY, Event.MODEL_OUTSIDE])
@pytest.mark.parametrize("learned", [False, True])
def test_gaps_of_80_ms_get_the_shifted_solution_while_an_event_asks_for_the_nominal_model(
    vehicle: Vehicle, controller: Controller, event: Event, learned: bool
) -> None:
    flight = prepare(vehicle, controller, nominal=Controller.build(vehicle) if learned else None)
    flight.run(30.0, until=Phase.TRACK)
    flown = gaps(flight, 0.08, {event.value: "as planted"})
    sustained = Fallback.NOMINAL_MODEL if learned else Fallback.NONE
    assert set(flown) == {sustained, Fallback.SHIFTED_SOLUTION}
    assert flown.count(Fallback.SHIFTED_SOLUTION) <= 9
    assert flight.flyer.engagement.flying
    assert max(flight.story.errors) < 0.3
    entered = [step.reason for step in flight.story.transitions if step.after is State.FALLBACK]
    assert learned or all("no fresh estimate" in reason for reason in entered)


def test_two_controllers_that_fail_end_the_stream_with_the_solver_as_the_reason(vehicle: Vehicle) -> None:
    failing, nominal = Watched(Controller.build(vehicle)), Watched(Controller.build(vehicle))
    flight = prepare(vehicle, failing, nominal=nominal)  # type: ignore[arg-type]
    flight.run(30.0, until=Phase.TRACK)
    failing.fails = nominal.fails = True
    flight.findings = {Event.DEADLINES_MISSED.value: "as planted"}
    flight.run(3.0)
    assert flight.story.after[-1] is State.STANDBY
    assert "the solver failed" in flight.story.transitions[-1].reason


def test_a_vehicle_that_falls_silent_gets_nothing_more_and_control_is_not_taken_back(
    vehicle: Vehicle, controller: Controller
) -> None:
    flight = tracking(vehicle, controller)
    flight.frozen, flight.connected = True, False
    flight.findings = {Event.LINK_LOST.value: "for 1.0 s"}
    flight.run(0.05)
    assert flight.story.after[-1] is State.DISCONNECTED
    assert flight.story.transitions[-1].reason == "nothing arrives from the vehicle: for 1.0 s"
    flight.frozen, flight.connected, flight.findings = False, True, {}
    flight.run(2.0)
    assert flight.story.decisions[-1].rate_body is None


EVENTS = st.dictionaries(st.sampled_from([event.value for event in Event]), st.just("planted"), max_size=2)


@settings(max_examples=15, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
@given(
    st.lists(
        st.tuples(
            st.floats(0.01, 2.5),
            EVENTS,
            st.booleans(),
            st.sampled_from(["OFFBOARD", "OFFBOARD", "HOLD"]),
            st.sampled_from([True, True, True, False]),
        ),
        max_size=8,
    ),
    st.floats(0.5, 1.5),
)
def test_whatever_happens_no_tick_raises_and_no_setpoint_is_out_of_bounds(
    vehicle: Vehicle,
    controller: Controller,
    events: list[tuple[float, dict[str, str], bool, str, bool]],
    effectiveness: float,
) -> None:
    flight = prepare(vehicle, controller, effectiveness=effectiveness)
    flight.run(4.0)
    for duration, findings, frozen, mode, connected in events:
        flight.findings, flight.frozen, flight.connected = findings, frozen or not connected, connected
        flight.mode = mode if flight.flyer.engagement.flying else flight.mode
        flight.run(duration)
    if not flight.flyer.engagement.streaming:
        flight.run(0.5)  # of parting, level and slow
    limit, heard = np.array(vehicle.limits.rate) + 1e-9, 0.0
    for (observation, _), decision in zip(flight.story.observations, flight.story.decisions, strict=True):
        heard = observation.time if observation.connected else heard
        if decision.rate_body is None:
            continue
        assert np.all(np.abs(decision.rate_body) <= limit)
        assert 0.0 <= decision.thrust <= 1.0
        assert observation.time - heard < 0.5  # its last setpoints: a link that is not heard may still be listened to
    if flight.story.after[-1] is State.STANDBY:
        assert flight.story.decisions[-1].rate_body is None


def test_plans_of_zero_settling_fly_too(vehicle: Vehicle, controller: Controller) -> None:
    flight = prepare(vehicle, controller, plan=Plan(settle=0.0, height=0.8))
    assert flight.run(40.0).phases == FULL


@pytest.mark.parametrize("height", [-0.7, 1.1])
def test_a_reference_counts_from_where_the_vehicle_stands_whatever_the_estimate_says_of_it(
    vehicle: Vehicle, controller: Controller, height: float, estimate: str
) -> None:
    flight = prepare(vehicle, controller, plan=msgspec.structs.replace(PLAN, origin="takeoff"))
    flight.offset = np.array([3.0, -2.0, height])
    flight.run(20.0, until=Phase.TRACK)
    flight.run(0.5)
    drift = 0.0 if estimate == "exact" else 0.7  # that an estimate may have gone meanwhile, m
    assert flight.plant.state[2] == pytest.approx(1.5, abs=0.05 + drift)
    story = flight.run(40.0)
    assert story.phases == FULL
    at_start = flight.offset if estimate == "exact" else flight.offset + Px4Estimate(seed=7)(0.0)[0:3]
    np.testing.assert_allclose(flight.flyer.mission.origin, at_start, atol=1e-6 + drift)
    assert np.linalg.norm(story.states[-1][0:2]) < 0.2 + drift


def test_a_vehicle_that_lies_on_its_side_is_not_armed(vehicle: Vehicle, controller: Controller, estimate: str) -> None:
    flight = prepare(vehicle, controller)
    flight.plant.righting = False
    flight.plant.state[ATTITUDE] = quaternion.from_euler(np.radians(61.0), 0.0, 0.0)
    story = flight.run(3.0)
    assert all(decision.rate_body is None and not decision.requests for decision in story.decisions)
    assert ("61 degrees" if estimate == "exact" else "not stand upright") in flight.flyer.engagement.refusal


def test_a_vehicle_that_is_held_is_disarmed_with_the_reason(vehicle: Vehicle, controller: Controller) -> None:
    flight = prepare(vehicle, controller)
    flight.plant.step = lambda rate_body, thrust, dt: None  # type: ignore[method-assign]
    story = flight.run(15.0)
    assert Event.TAKEOFF_FAILED in story.raised
    assert "did not take off and disarmed: no lift-off" in story.transitions[-1].reason
    assert "is it held" in flight.flyer.mission.landing_reason
    assert not flight.armed
    assert not flight.flyer.landed


def test_a_take_off_that_tips_over_ends_at_once(vehicle: Vehicle, controller: Controller) -> None:
    flight = prepare(vehicle, controller)
    flight.plant.righting = False
    flight.run(10.0, until=Phase.RAMP)
    flight.run(0.8)
    flight.plant.state[ATTITUDE] = quaternion.from_euler(0.0, np.radians(20.0), 0.0)
    flight.run(0.5)
    assert Event.TIPPING in flight.story.raised
    assert flight.story.decisions[-1].collective_thrust < 0.1 * vehicle.weight


def test_a_rotor_that_lost_too_much_lands_the_vehicle_which_does_not_take_off_again(vehicle: Vehicle) -> None:
    options = ControllerOptions.for_vehicle(vehicle, adaptation=AdaptationSettings(mode="on"))
    controller = Controller.build(vehicle, options)
    flight = prepare(vehicle, controller)
    flight.flyer.motors = (2, 1, 3, 0)
    flight.run(30.0, until=Phase.TRACK)
    assert controller.adaptation is not None
    assert controller.adaptation.rotors is not None
    controller.adaptation.rotors._test.losses[0] = RotorLoss(0, 0.15, 0.02)
    flight.run(0.5)
    assert flight.flyer.mission.phase is Phase.TRACK
    weak = next(change.text for change in flight.story.event_changes if change.event is Event.ROTOR_WEAK)
    assert "rotor 0 (motor 3) has lost 15 +- 4 % of thrust, or a load of 0.0094 kg hangs under it" in weak
    controller.adaptation.rotors._test.losses[0] = RotorLoss(0, 0.3, 0.02)
    story = flight.run(30.0)
    assert story.phases[-1] is Phase.SHUTDOWN
    text = "rotor 0 (motor 3) has lost 30 +- 4 % of thrust, or a load of 0.019 kg hangs under it"  # 0.3 of m/4
    assert text in flight.flyer.mission.landing_reason
    flight.engage = True
    transitions = len(story.transitions)
    story = flight.run(5.0)
    assert State.ENGAGED not in [transition.after for transition in story.transitions[transitions:]]
    assert not flight.armed
