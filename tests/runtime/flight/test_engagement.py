"""Control is taken only on request, only when HEARTBEAT confirms it, and given up whenever someone else has it."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from runtime.flight.engagement import AutopilotRequest, Engagement, EngagementSettings, Facts, State, Transition
from runtime.flight.events import Fallback

GROUND = Facts(connected=True, armed=False, offboard=False, mode="HOLD")
OFFBOARD = replace(GROUND, offboard=True, mode="OFFBOARD")
FLYING = replace(OFFBOARD, armed=True)
SETTINGS = EngagementSettings()


def run(machine: Engagement, facts: Facts, start: float, end: float, step: float = 0.01) -> list[Transition]:
    transitions: list[Transition] = []
    time = start
    while time < end:
        transitions += machine.update(facts, time)
        time += step
    return transitions


def engaged() -> Engagement:
    machine = Engagement(SETTINGS)
    machine.update(GROUND, 0.0)
    machine.engage()
    run(machine, GROUND, 0.01, 1.5)
    run(machine, OFFBOARD, 1.5, 2.0)
    run(machine, FLYING, 2.0, 2.1)
    assert machine.state is State.ENGAGED
    return machine


def test_without_a_request_it_never_leaves_standby() -> None:
    machine = Engagement(SETTINGS)
    transitions = run(machine, GROUND, 0.0, 5.0)
    assert [transition.after for transition in transitions] == [State.STANDBY]
    assert not machine.streaming


def test_it_streams_before_it_requests_offboard_and_requests_arming_last() -> None:
    machine = Engagement(SETTINGS)
    machine.update(GROUND, 0.0)
    machine.engage()
    requests: list[tuple[float, AutopilotRequest]] = []
    time, facts = 0.0, GROUND
    while machine.state is not State.ENGAGED:
        machine.update(facts, time)
        requests += [(time, request) for request in machine.requests]
        if requests and requests[-1][1] is AutopilotRequest.OFFBOARD and time - requests[-1][0] > 0.5:
            facts = OFFBOARD
        if requests and requests[-1][1] is AutopilotRequest.ARM and time - requests[-1][0] > 0.5:
            facts = FLYING
        time += 0.01
        assert time < 10.0
    assert [request for _, request in requests] == [AutopilotRequest.OFFBOARD, AutopilotRequest.ARM]
    assert requests[0][0] >= SETTINGS.stream_time


def test_an_acknowledged_mode_that_no_heartbeat_shows_ends_in_standby_with_the_reason() -> None:
    machine = Engagement(SETTINGS)
    machine.update(GROUND, 0.0)
    machine.engage()
    transitions = run(machine, GROUND, 0.01, 15.0)
    assert [transition.after for transition in transitions] == [State.STREAMING, State.STANDBY]
    assert "HEARTBEAT did not show OFFBOARD" in machine.refusal
    assert not machine.streaming


def test_requests_are_repeated_but_not_every_tick() -> None:
    machine = Engagement(SETTINGS)
    machine.update(GROUND, 0.0)
    machine.engage()
    count, time = 0, 0.0
    while time < SETTINGS.stream_time + 3.5:
        machine.update(GROUND, time)
        count += len(machine.requests)
        time += 0.01
    assert count == 4


def test_without_arm_it_waits_for_the_pilot_to_arm() -> None:
    machine = Engagement(EngagementSettings(arm=False))
    machine.update(GROUND, 0.0)
    machine.engage()
    requests: list[AutopilotRequest] = []
    for tick in range(400):
        machine.update(GROUND if tick < 200 else OFFBOARD, tick * 0.01)
        requests += machine.requests
    assert set(requests) == {AutopilotRequest.OFFBOARD}
    machine.update(FLYING, 4.0)
    assert machine.state is State.ENGAGED


def awaiting_pilot(pilot_patience: float | None = None) -> Engagement:
    """In OFFBOARD from 2.0 s on, disarmed."""
    machine = Engagement(EngagementSettings(arm=False, pilot_patience=pilot_patience))
    machine.update(GROUND, 0.0)
    machine.engage()
    run(machine, GROUND, 0.01, 2.0)
    assert not machine.awaits_pilot
    run(machine, OFFBOARD, 2.0, 3.5)
    assert machine.awaits_pilot
    return machine


def test_the_pilot_has_as_long_as_it_takes_to_arm() -> None:
    machine = awaiting_pilot()
    assert run(machine, OFFBOARD, 3.5, 100.0) == []
    run(machine, FLYING, 100.0, 100.1)
    assert machine.state is State.ENGAGED
    assert not machine.awaits_pilot


def test_the_pilot_has_the_time_that_is_given_to_arm() -> None:
    machine = awaiting_pilot(pilot_patience=20.0)
    assert run(machine, OFFBOARD, 3.5, 21.9) == []
    (left,) = run(machine, OFFBOARD, 21.9, 30.0)
    assert left.reason == "the pilot did not arm within 20 s"


def test_a_pilot_who_chooses_another_mode_before_arming_is_not_asked_for_offboard_again() -> None:
    machine = awaiting_pilot()
    (left,) = run(machine, replace(GROUND, mode="POSCTL"), 3.5, 30.0)
    assert left.reason == "mode changed to POSCTL before the pilot armed"
    assert not machine.requested
    assert run(machine, replace(FLYING, offboard=False, mode="POSCTL"), 30.0, 60.0) == []


def test_a_mode_that_was_accepted_and_refused_at_once_is_requested_again() -> None:
    machine = Engagement(EngagementSettings(arm=False))
    machine.update(GROUND, 0.0)
    machine.engage()
    run(machine, GROUND, 0.01, 2.0)
    run(machine, OFFBOARD, 2.0, 2.3)
    requests = []
    for tick in range(230, 400):
        machine.update(GROUND, 0.01 * tick)
        requests += machine.requests
    assert AutopilotRequest.OFFBOARD in requests
    assert machine.state is State.STREAMING


def test_a_vehicle_armed_before_is_left_alone() -> None:
    machine = Engagement(SETTINGS)
    machine.engage()
    transitions = run(machine, replace(FLYING, offboard=False, mode="HOLD"), 0.0, 10.0)
    assert [transition.after for transition in transitions] == [State.STANDBY]
    assert "already armed" in machine.refusal
    assert "--resume" in machine.refusal


def test_a_vehicle_armed_before_is_taken_over_with_resume() -> None:
    machine = Engagement(EngagementSettings(resume=True))
    machine.engage()
    run(machine, replace(FLYING, offboard=False, mode="HOLD"), 0.0, 2.0)
    assert machine.state is State.STREAMING
    run(machine, FLYING, 2.0, 2.1)
    assert machine.state is State.ENGAGED


def test_when_the_pilot_takes_the_mode_it_stops_and_stays_away() -> None:
    machine = engaged()
    transitions = run(machine, replace(FLYING, offboard=False, mode="POSCTL"), 3.0, 4.0)
    assert [transition.after for transition in transitions] == [State.STANDBY]
    assert "POSCTL" in transitions[0].reason
    # PX4 went back to OFFBOARD by itself or the pilot did: still nothing was requested
    assert run(machine, FLYING, 4.0, 20.0) == []
    assert not machine.streaming


def test_a_disarmed_vehicle_is_not_armed_again() -> None:
    machine = engaged()
    assert [transition.reason for transition in run(machine, OFFBOARD, 3.0, 20.0)] == ["vehicle disarmed"]


def test_low_rates_refuse_engagement_until_they_are_met() -> None:
    machine = Engagement(SETTINGS)
    machine.engage()
    slow = replace(GROUND, refusal="streams are too slow: ATTITUDE 30 of 100 Hz")
    run(machine, slow, 0.0, 3.0)
    assert machine.state is State.STANDBY
    assert "ATTITUDE 30 of 100 Hz" in machine.refusal
    run(machine, GROUND, 3.0, 3.1)
    assert machine.state is State.STREAMING


def test_a_hindrance_while_streaming_delays_engagement_and_does_not_end_it() -> None:
    machine = Engagement(SETTINGS)
    machine.update(GROUND, 0.0)
    machine.engage()
    run(machine, GROUND, 0.01, 0.5)
    machine.update(replace(GROUND, refusal="no fresh estimate"), 0.5)
    assert machine.state is State.STANDBY
    assert "no fresh estimate" in machine.refusal
    machine.update(GROUND, 0.51)
    assert machine.state is State.STREAMING


def test_a_fallback_is_entered_and_left_with_reasons() -> None:
    machine = engaged()
    bad = replace(FLYING, fallback=Fallback.SHIFTED_SOLUTION, reason="no fresh estimate: 60 ms old")
    (entered,) = machine.update(bad, 3.0)
    assert entered.after is State.FALLBACK
    assert "60 ms old" in entered.reason
    (left,) = machine.update(FLYING, 3.1)
    assert left.after is State.ENGAGED


def test_stop_streaming_is_final() -> None:
    machine = engaged()
    bad = replace(FLYING, fallback=Fallback.STOP_STREAMING, reason="nothing arrives")
    (stopped,) = machine.update(bad, 3.0)
    assert stopped.after is State.STANDBY
    assert run(machine, FLYING, 3.1, 20.0) == []


def test_a_lost_link_and_its_return_do_not_bring_control_back() -> None:
    machine = engaged()
    (lost,) = machine.update(replace(FLYING, connected=False), 3.0)
    assert lost.after is State.DISCONNECTED
    transitions = run(machine, FLYING, 4.0, 20.0)
    assert [transition.after for transition in transitions] == [State.STANDBY]


FACTS = st.builds(
    Facts,
    connected=st.booleans(),
    armed=st.booleans(),
    offboard=st.booleans(),
    mode=st.just("X"),
    refusal=st.sampled_from(["", "", "", "slow"]),
    fallback=st.sampled_from(list(Fallback)),
)


@given(st.lists(st.tuples(st.floats(0, 3), FACTS, st.booleans()), max_size=80))
def test_whatever_happens_streaming_starts_only_after_a_request_since_the_last_end(
    history: list[tuple[float, Facts, bool]],
) -> None:
    machine = Engagement(SETTINGS)
    requested = False
    time = 0.0
    for step, facts, engage in history:
        time += step
        if engage:
            machine.engage()
            requested = True
        before, flew = machine.streaming, machine.flying
        for transition in machine.update(facts, time):
            assert transition.reason
            assert transition.before is not transition.after
        if machine.streaming and not before:
            assert requested
            assert not machine.refusal
        if before and not machine.streaming:
            assert not (flew and machine.requested)
            requested = machine.requested
        if machine.flying and facts.connected:
            assert facts.armed
            assert facts.offboard


def test_a_mode_that_changed_while_this_computer_stood_still_is_not_put_down_to_the_pilot() -> None:
    machine = Engagement(SETTINGS)
    machine.update(GROUND, 0.0)
    machine.engage()
    run(machine, GROUND, 0.01, 1.0)
    run(machine, FLYING, 1.0, 4.0)
    assert machine.state is State.ENGAGED
    (transition,) = machine.update(replace(FLYING, offboard=False, mode="RTL", standstill=2.0), 6.0)
    assert transition.reason == "mode changed to RTL after this computer stood still for 2.0 s"


def test_what_was_to_be_armed_is_armed_again_by_another_request_alone() -> None:
    """As after a reboot of the autopilot that has just armed: somebody may walk up to it."""
    machine = Engagement(SETTINGS)
    machine.update(GROUND, 0.0)
    machine.engage()
    run(machine, GROUND, 0.01, 2.0)
    requests: list[AutopilotRequest] = []
    run(machine, OFFBOARD, 2.0, 2.5)
    machine.update(replace(OFFBOARD, refusal="no fresh estimate"), 2.6)
    assert machine.state is State.STANDBY
    assert not machine.requested
    for tick in range(1000):
        machine.update(GROUND, 3.0 + 0.01 * tick)
        requests += machine.requests
    assert not requests
