"""The table of phases is complete, every flight can be ended by it, and nothing moves a phase beside it."""

from __future__ import annotations

import ast
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from runtime.flight.phases import PHASES, START, Condition, Handler, Phase, Target, Trigger, next_phase
from runtime.flight.phases import Path as Motion

ROOT = Path(__file__).parents[3]
FLYING = [phase for phase, policy in PHASES.items() if policy.airborne]
TABLE = "runtime/flight/phases.py"


def targets(target: Target) -> set[Phase]:
    if target is None:
        return set()
    return {target} if isinstance(target, Phase) else set(target.values())


def reachable(start: Phase, triggers: set[Trigger]) -> set[Phase]:
    there, open_phases = {start}, [start]
    while open_phases:
        on = PHASES[open_phases.pop()].on
        new = set().union(*(targets(on.get(trigger)) for trigger in triggers)) - there
        there |= new
        open_phases += new
    return there


def test_every_phase_has_a_row_with_a_text() -> None:
    assert set(PHASES) == set(Phase)
    assert all(policy.text for policy in PHASES.values())


def test_every_phase_is_reachable_on_the_ground_and_all_but_the_take_off_in_the_air() -> None:
    assert reachable(START, set(Trigger)) == set(Phase)
    from_air = reachable(Phase.BRAKE, set(Trigger) - {Trigger.TAKE_OFF, Trigger.TAKE_OVER})
    assert from_air == set(Phase) - {Phase.GROUND, Phase.RAMP, Phase.CLIMB}


@pytest.mark.parametrize("phase", Phase)
def test_every_cell_with_conditions_has_an_answer_when_none_of_them_holds(phase: Phase) -> None:
    for target in PHASES[phase].on.values():
        if not isinstance(target, (Phase, type(None))):
            assert list(target)[-1] is Condition.OTHERWISE


@pytest.mark.parametrize("phase", Phase)
def test_every_phase_says_what_an_abort_does_and_control_can_be_taken_again(phase: Phase) -> None:
    assert {Trigger.ABORT, Trigger.TAKE_OFF, Trigger.TAKE_OVER} <= set(PHASES[phase].on)


@pytest.mark.parametrize("phase", FLYING)
def test_every_phase_that_flies_can_be_aborted_sunk_and_stopped_by_the_ground(phase: Phase) -> None:
    on = PHASES[phase].on
    assert {Trigger.ABORT, Trigger.SINK, Trigger.CONTACT} <= set(on)
    for trigger in (Trigger.ABORT, Trigger.SINK):  # one that is flown on with lands already
        assert next_phase(phase, trigger) is not None or PHASES[phase].lands
    assert on[Trigger.CONTACT] is Phase.CONTACT


@pytest.mark.parametrize("phase", FLYING)
def test_after_an_abort_a_flight_leads_to_the_ground_and_not_back_to_its_reference(phase: Phase) -> None:
    after, holding = next_phase(phase, Trigger.ABORT) or phase, {Condition.ENDING, Condition.TRACKED}
    course = [after]
    while (after := next_phase(course[-1], Trigger.DONE, holding)) is not None:
        assert after not in course
        course.append(after)
    assert {PHASES[each].path for each in course} <= {Motion.STOP, Motion.TO_LOW, Motion.DOWN}
    assert course[-1] is Phase.TOUCHDOWN  # which only the ground ends
    contact = next_phase(course[-1], Trigger.CONTACT)
    assert contact is not None
    assert next_phase(contact, Trigger.CARRIED) is Phase.SHUTDOWN


@given(st.lists(st.tuples(st.sampled_from(Trigger), st.sets(st.sampled_from(Condition)))))
def test_any_course_can_still_be_brought_to_rest(course: list[tuple[Trigger, set[Condition]]]) -> None:
    phase = START
    for trigger, holding in course:
        phase = next_phase(phase, trigger, holding) or phase
    phase = next_phase(phase, Trigger.ABORT) or phase
    phase = next_phase(phase, Trigger.CONTACT) or phase
    assert (next_phase(phase, Trigger.CARRIED) or phase) is Phase.SHUTDOWN


def test_disarming_is_expected_exactly_where_the_vehicle_may_stand() -> None:
    standing = {Phase.TOUCHDOWN, Phase.CONTACT, Phase.SHUTDOWN}
    assert {phase for phase, policy in PHASES.items() if policy.may_disarm} == standing


def test_what_flies_has_a_motion_and_what_does_not_has_none() -> None:
    for policy in PHASES.values():
        assert policy.airborne == (policy.path is not Motion.NONE) == (policy.handler is Handler.FLY)


# --- no transition beside the table


def modules() -> Iterator[tuple[str, ast.Module]]:
    for path in sorted((ROOT / "runtime").rglob("*.py")):
        yield path.relative_to(ROOT).as_posix(), ast.parse(path.read_text(encoding="utf-8"))


def places(condition: Callable[[ast.AST], bool]) -> list[tuple[str, str]]:
    """(file, function) of every node of the runtime for which the condition holds."""
    return [
        (name, function.name)
        for name, tree in modules()
        for function in ast.walk(tree)
        if isinstance(function, ast.FunctionDef)
        for node in ast.walk(function)
        if condition(node)
    ]


def test_no_module_but_the_table_names_a_phase() -> None:
    naming = {
        name
        for name, tree in modules()
        for node in ast.walk(tree)
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "Phase"
    }
    assert naming == {TABLE}


def test_the_phase_is_assigned_in_one_place_that_reads_the_table() -> None:
    def assigns(node: ast.AST) -> bool:
        return isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store) and node.attr in ("phase", "_phase")

    def reads_table(node: ast.AST) -> bool:
        return isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "next_phase"

    mission = "runtime/flight/mission.py"
    assert set(places(assigns)) == {(mission, "__init__"), (mission, "_move")}
    assert places(reads_table) == [(mission, "_move")]
