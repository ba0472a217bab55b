"""The verdict: a healthy log is good, planted faults are named, and what the data cannot answer is stated."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from dynamics.effects import CATALOGUE
from flights.log import Log, Stream
from flights.quality.identifiable import answers
from flights.quality.inspection import Inspection, judge
from tests.support.simulated_flight import changed, flown, thinned, values, without


@pytest.fixture(scope="module")
def log() -> Log:
    return flown().log


@pytest.fixture(scope="module")
def healthy(log: Log) -> Inspection:
    return judge(log)


def names(inspection: Inspection, severity: str | None = None) -> set[str]:
    return {finding.name for finding in inspection.findings if severity in (None, finding.severity)}


def test_a_healthy_log_is_good_and_has_nothing_to_complain_of(healthy: Inspection) -> None:
    assert healthy.verdict == "good"
    assert names(healthy, "error") == set()
    assert names(healthy, "warning") == set()
    assert healthy.free_flight == pytest.approx(healthy.duration, abs=0.1)


def test_every_effect_of_the_catalogue_has_an_answer(healthy: Inspection) -> None:
    assert [effect.name for effect in healthy.effects] == list(CATALOGUE)
    answered = {effect.name: effect.answer for effect in healthy.effects}
    assert answered["rotor_drag"] == answered["inertia"] == answered["blade_flapping"] == "yes"
    assert answered["ground_effect"] == "no"  # flown a metre above it


def test_motors_at_10_hz_cannot_answer(log: Log) -> None:
    slow = thinned(thinned(log, "rotor_speed", 10), "rotor_command", 10)
    inspection = judge(slow)
    assert inspection.verdict == "unusable"
    assert "rotors_too_slow" in names(inspection, "error")
    assert {effect.answer for effect in inspection.effects if effect.name in ("inertia", "motor_lag")} == {"no"}


def test_advice_for_px4_names_the_profile_to_set(log: Log) -> None:
    slow = thinned(without(log, "rotor_speed"), "rotor_command", 10)
    px4 = replace(slow, provenance=replace(log.provenance, format="PX4 ULog"), parameters={"SDLOG_PROFILE": 131.0})
    assert any("SDLOG_PROFILE from 131 to 155" in advice for advice in judge(px4).advice)


def test_a_log_without_rotors_cannot_answer(log: Log) -> None:
    inspection = judge(without(log, "rotor_speed", "rotor_command", "thrust_setpoint"))
    assert inspection.verdict == "unusable"
    assert names(inspection, "error") == {"no_rotors"}


def test_a_battery_that_stands_still_is_named_and_identifies_no_sag(log: Log) -> None:
    stuck = np.full_like(values(log, "battery_voltage"), 11.1)
    inspection = judge(changed(log, "battery_voltage", stuck))
    assert next(f.text for f in inspection.findings if f.name == "frozen_channel").startswith("battery_voltage")
    sag = next(effect for effect in inspection.effects if effect.name == "battery_sag")
    assert sag.answer == "no"
    assert "battery voltage, which is logged but stands still" in sag.why


def test_commands_alone_identify_nothing_that_their_gain_takes_up(log: Log, healthy: Inspection) -> None:
    commanded = {effect.name: effect for effect in judge(without(log, "rotor_speed")).effects}
    measured = {effect.name: effect.answer for effect in healthy.effects}
    assert measured["thrust_constant"] == measured["mass"] == "yes"
    assert commanded["thrust_constant"].answer == commanded["rotor_speed_fault"].answer == "no"
    assert "measured rotor speeds" in commanded["thrust_constant"].why
    assert commanded["mass"].answer == "weakly"
    assert commanded["rotor_drag"].answer == measured["rotor_drag"]


@pytest.mark.parametrize("column", ["velocity_y", "attitude_w", "rate_z"])
def test_a_column_without_a_number_is_named_where_it_leaves_no_flight(log: Log, column: str) -> None:
    quantity, place = column[:-2], {"w": 0, "x": 0, "y": 1, "z": 2}[column[-1]]
    table = values(log, quantity).copy()
    table[:, place] = np.nan
    inspection = judge(changed(log, quantity, table))
    assert inspection.verdict == "unusable"
    assert f"{column} holds no number at all" in inspection.sentence


def test_a_position_that_is_fast_enough_shows_what_a_velocity_does(log: Log) -> None:
    """The diagnosis takes its derivative, and inspection said that nothing could be identified."""
    with_velocity = judge(without(log, "specific_force"))
    bare = judge(without(log, "specific_force", "velocity"))
    answers = {effect.name: effect.answer for effect in with_velocity.effects}
    assert answers["linear_drag"] != "no"
    assert {effect.name: effect.answer for effect in bare.effects} == answers
    neither = judge(without(log, "specific_force", "velocity", "position"))
    assert next(effect for effect in neither.effects if effect.name == "linear_drag").answer == "no"


@pytest.mark.parametrize("rotor", range(4))
def test_a_rotor_that_reads_half_while_commands_agree_is_a_sensor_fault(log: Log, rotor: int) -> None:
    speed = values(log, "rotor_speed")
    speed[:, rotor] *= 0.5
    inspection = judge(changed(log, "rotor_speed", speed))
    (fault,) = [finding for finding in inspection.findings if finding.name == "rotor_speed_fault"]
    assert fault.text.startswith(f"rotor {rotor} reads 0.5")
    assert fault.severity == "error"
    assert inspection.verdict == "limited"


def test_a_rotor_that_reads_zero_for_a_while_is_a_sensor_fault(log: Log) -> None:
    speed = values(log, "rotor_speed")
    speed[500:620, 2] = 0.0
    (fault,) = [f for f in judge(changed(log, "rotor_speed", speed)).findings if f.name == "rotor_speed_fault"]
    assert fault.text.startswith("rotor 2 reads zero for 1.2 s")


def test_a_rotor_that_is_commanded_to_turn_slower_is_no_sensor_fault(log: Log) -> None:
    speed, command = values(log, "rotor_speed"), values(log, "rotor_command")
    speed[:, 1] *= 0.7
    command[:, 1] *= 0.7
    findings = names(judge(changed(changed(log, "rotor_speed", speed), "rotor_command", command)))
    assert "uneven_rotor" in findings
    assert "rotor_speed_fault" not in findings


@pytest.mark.parametrize(("share", "name"), [(0.75, "uneven_rotor"), (1.4, "uneven_rotor"), (0.4, "rotor_speed_fault")])
def test_without_commands_a_rotor_may_be_uneven_for_a_reason(log: Log, share: float, name: str) -> None:
    """Opposite rotors at 1.3 and 0.8 of their peers hold a rotor that is canted."""
    speed = values(log, "rotor_speed")
    speed[:, 1] *= share
    bare = without(changed(log, "rotor_speed", speed), "rotor_command", "thrust_setpoint")
    (finding,) = [f for f in judge(bare).findings if f.name in ("uneven_rotor", "rotor_speed_fault")]
    assert finding.name == name
    assert finding.severity == ("warning" if name == "uneven_rotor" else "error")


def test_a_channel_that_freezes_in_flight_is_named(log: Log) -> None:
    position = values(log, "position")
    position[300:1500, 1] = position[300, 1]
    findings = [f.text for f in judge(changed(log, "position", position)).findings if f.name == "frozen_channel"]
    assert findings
    assert findings[0].startswith("position_y stands at")


def test_an_accelerometer_that_clips_is_named(log: Log) -> None:
    force = values(log, "specific_force")
    clipped = np.minimum(force, np.percentile(force[:, 2], 90))
    findings = [f.text for f in judge(changed(log, "specific_force", clipped)).findings if f.name == "saturation"]
    assert any(text.startswith("specific_force_z stays at") for text in findings)


def test_gaps_and_repeated_samples_are_counted(log: Log) -> None:
    stream = log.stream("velocity")
    assert stream is not None
    rows = (stream.time < 5) | (stream.time > 6)
    gapped = replace(
        log,
        streams=tuple(
            Stream(s.name, s.time[rows], s.values[rows], s.source) if s.name == "velocity" else s for s in log.streams
        ),
    )
    inspection = judge(gapped)
    channel = next(channel for channel in inspection.channels if channel.quantity == "velocity")
    assert channel.gaps == 1
    assert channel.longest_gap == pytest.approx(1.01, abs=0.02)
    assert len(inspection.segments) == 2
    held = np.repeat(values(log, "attitude")[::4], 4, axis=0)[: len(values(log, "attitude"))]
    repeated = judge(changed(log, "attitude", held))
    assert "repeated_samples" in names(repeated, "warning")


def test_wrong_frames_cannot_answer(log: Log) -> None:
    upside_down = values(log, "specific_force") * np.array([1.0, -1.0, -1.0])
    inspection = judge(changed(log, "specific_force", upside_down))
    assert names(inspection, "error") & {"frames_upside_down", "force_frame"}
    assert inspection.verdict == "unusable"


def test_a_clock_offset_is_noted(log: Log) -> None:
    shifted = replace(
        log,
        streams=tuple(
            Stream(s.name, s.time + (0.03 if s.name == "attitude" else 0.0), s.values, s.source) for s in log.streams
        ),
    )
    (offset,) = [finding for finding in judge(shifted).findings if finding.name == "clock_offset"]
    assert offset.severity == "note"
    assert "removed before" in offset.advice
    assert not re.search(r"\b(flights|alula|diagnosis)\.\w", offset.advice)  # for somebody who clicks


def test_an_answer_for_an_effect_that_is_not_excited_names_what_to_fly() -> None:
    answer_of = {answer.name: answer for answer in answers({"rate", "rotor_speed"}, {"yaw_acceleration": 0.1})}
    assert answer_of["torque_constant"].answer == "no"
    assert "fly yaw_spin" in answer_of["torque_constant"].why
    assert answer_of["rotor_drag"].why == "needs an accelerometer or velocity and velocity and attitude"
    assert answer_of["mass"].ambiguous_with == "thrust_constant"
