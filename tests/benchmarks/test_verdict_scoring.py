"""The five outcomes of the judge, of answers made by hand."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pytest

from benchmarks.verdict.scoring import Answer, Expected, HeldStatement, Outcome, intervals, outcome_of, unnamed

DRAG, MASS = {"coefficient": 0.02}, {"ratio": 1.25}
NOTHING = Expected()
ONE = Expected({"linear_drag": DRAG}, ("linear_drag",))
TWO = Expected({"linear_drag": DRAG, "mass": MASS}, ("linear_drag", "mass"))
WEAK = Expected({"linear_drag": DRAG})
ROTOR = Expected({"weak_rotor": {"loss": 0.05, "rotor": 2.0}}, ("weak_rotor",))
FOREIGN = Expected(allowed=("unknown",), outside=True)
MUTATED = Expected({"linear_drag": DRAG}, ("linear_drag",), ("rotor_drag",), ("refused", "unknown"))
SENSED = Expected({"centre_of_mass": {"x": 0.004}}, ("centre_of_mass",))


def effect(name: str, *alike: str, confidence: float = 1.0, rotor: int | None = None, **values: Any) -> dict[str, Any]:
    """An effect of a report; values are (value, std)."""
    parameters = {key: {"value": value, "std": std, "unit": "1"} for key, (value, std) in values.items()}
    return {
        "name": name, "rotor": rotor, "parameters": parameters, "confidence": confidence, "ambiguous_with": list(alike),
    }  # fmt: skip


def reply(verdict: str, *effects: Mapping[str, Any], gain: tuple[str, ...] = ()) -> Answer:
    """An answer with a verdict and its effects. gain: effects that are declared to be behind a gain of the commands."""
    look_alikes = {"value": 0.8, "std": 0.01, "look_alikes": list(gain)}
    return Answer({"verdict": verdict, "effects": list(effects), "command_gain": look_alikes if gain else None})


MAYBE_INERTIA = effect("inertia", confidence=0.6)
LOADED = Expected({"mass": MASS}, ("mass",))
GAIN = reply("explained", gain=("mass", "thrust_constant"))
REFUSED, FAILED = Answer(refusal="too short"), Answer(error="ValueError: shapes")
CASES = {
    "nothing is explained": (reply("explained"), NOTHING, Outcome.RIGHT),
    "the effect alone": (reply("effect", effect("linear_drag")), ONE, Outcome.RIGHT),
    "both effects": (reply("effect", effect("mass"), effect("linear_drag")), TWO, Outcome.RIGHT),
    "its rotor": (reply("effect", effect("weak_rotor", rotor=2)), ROTOR, Outcome.RIGHT),
    "a force of no catalogue": (reply("unknown"), FOREIGN, Outcome.RIGHT),
    "a mutated log is refused": (REFUSED, MUTATED, Outcome.RIGHT),
    "a mutated log is unknown": (reply("unknown"), MUTATED, Outcome.RIGHT),
    "made true by a mutation": (reply("effect", effect("rotor_drag"), effect("linear_drag")), MUTATED, Outcome.RIGHT),
    "a sensor that stayed in place": (reply("effect", effect("imu_lever_arm")), SENSED, Outcome.RIGHT),
    "too weak to be named": (reply("explained"), WEAK, Outcome.RIGHT),
    "too weak and named": (reply("effect", effect("linear_drag")), WEAK, Outcome.RIGHT),
    "beside a look-alike": (reply("ambiguous", effect("linear_drag", "rotor_drag")), ONE, Outcome.DECLARED),
    "as a look-alike": (reply("ambiguous", effect("rotor_drag", "linear_drag")), ONE, Outcome.DECLARED),
    "beside an unknown": (reply("unknown", effect("linear_drag")), ONE, Outcome.DECLARED),
    "behind a gain": (GAIN, LOADED, Outcome.DECLARED),
    "not named": (reply("explained"), ONE, Outcome.SILENT),
    "one of two": (reply("effect", effect("linear_drag")), TWO, Outcome.SILENT),
    "refused": (REFUSED, ONE, Outcome.SILENT),
    "refused where nothing is hidden": (REFUSED, NOTHING, Outcome.SILENT),
    "unknown without a name": (reply("unknown"), ONE, Outcome.SILENT),
    "a force of no catalogue is explained": (reply("explained"), FOREIGN, Outcome.SILENT),
    "a mutated log is explained": (reply("explained"), MUTATED, Outcome.SILENT),
    "unknown where nothing is missing": (reply("unknown"), NOTHING, Outcome.WRONG),
    "a false effect": (reply("effect", MAYBE_INERTIA), ONE, Outcome.WRONG),
    "a false effect beside the true one": (reply("effect", effect("linear_drag"), MAYBE_INERTIA), ONE, Outcome.WRONG),
    "a false effect in an unknown": (reply("unknown", effect("gust", confidence=0.4)), FOREIGN, Outcome.WRONG),
    "a false gain": (GAIN, NOTHING, Outcome.WRONG),
    "an error": (FAILED, MUTATED, Outcome.WRONG),
    "sure of a false effect": (reply("effect", effect("inertia", confidence=0.9)), ONE, Outcome.SURE_AND_WRONG),
    "sure of one in a mutated log": (reply("unknown", effect("inertia")), MUTATED, Outcome.SURE_AND_WRONG),
    "sure of look-alikes": (reply("ambiguous", effect("inertia", "mass")), NOTHING, Outcome.SURE_AND_WRONG),
    "sure of another rotor": (reply("effect", effect("weak_rotor", rotor=1)), ROTOR, Outcome.SURE_AND_WRONG),
    "sure where no catalogue has it": (reply("effect", effect("rotor_drag")), FOREIGN, Outcome.SURE_AND_WRONG),
}  # fmt: skip


@pytest.mark.parametrize(("answer", "expected", "outcome"), CASES.values(), ids=CASES)
def test_outcome(answer: Answer, expected: Expected, outcome: Outcome) -> None:
    assert outcome_of(answer, expected) is outcome


def test_every_outcome_has_a_case() -> None:
    assert {outcome for _, _, outcome in CASES.values()} == set(Outcome)


@pytest.mark.parametrize(
    ("statements", "outcome"),
    [
        ([(True, True, True), (False, True, True)], Outcome.RIGHT),
        ([(False, False, False), (True, True, True)], Outcome.SILENT),
        ([(False, False, False), (True, False, True)], Outcome.WRONG),
        ([(True, False, True), (True, False, False)], Outcome.SURE_AND_WRONG),
    ],
    ids=["all hold", "a demand does not", "a ban does not", "nor of the sure effects"],
)
def test_outcome_of_statements(statements: list[tuple[bool, bool, bool]], outcome: Outcome) -> None:
    held = tuple(HeldStatement("a statement", *each) for each in statements)
    assert outcome_of(Answer({"verdict": "effect"}, statements=held), NOTHING) is outcome


def test_declared_and_gains_count_as_named() -> None:
    answer = reply("ambiguous", effect("rotor_drag", "linear_drag"), gain=("mass",))
    assert unnamed(answer, TWO) == []
    assert unnamed(reply("explained"), TWO) == ["linear_drag", "mass"]


def test_intervals_count_what_was_fitted_of_what_is_hidden() -> None:
    truth = Expected({"linear_drag": DRAG, "ground_effect": {"gain": 2.0, "radius": 0.1}, "gust": {"intensity": 1.0}})
    answer = reply(
        "effect",
        effect("linear_drag", coefficient=(0.0239, 0.002)),  # 1.95 deviations off
        effect("ground_effect", gain=(2.5, 0.2), radius=(0.1, 0.0)),  # 2.5 off; the radius was held at the truth
        effect("gust", intensity=(3.0, 0.1)),
        effect("mass", ratio=(1.0, 0.1)),
    )
    assert intervals(answer, truth) == [True, False]


def test_values_beside_a_wrong_shape_or_rotor_do_not_count() -> None:
    truth = Expected({"ground_effect": {"gain": 2.0, "radius": 0.1}, "weak_rotor": {"loss": 0.05, "rotor": 2.0}})
    shape = effect("ground_effect", gain=(2.0, 0.2), radius=(0.2, 0.0))
    assert intervals(reply("effect", shape, effect("weak_rotor", rotor=1, loss=(0.05, 0.01))), truth) == []
