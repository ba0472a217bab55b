"""The five outcomes of an answer with a known truth, and whether its intervals hold that truth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from enum import StrEnum
from typing import Any

import msgspec

SURE = 0.9  # confidence, from which on a false name is sure
DEVIATIONS = 1.96  # standard deviations of a 95 % interval
HELD_SHAPE = 1e-3  # relative error of a held parameter, beyond which the fitted ones mean something else
NAMES: Mapping[str, tuple[str, ...]] = {  # under which the catalogue knows a hidden effect that is not its own
    "lost_propeller": ("weak_rotor",),
    "centre_of_mass": ("centre_of_mass", "imu_lever_arm", "pose_lever_arm"),  # the sensors stay where they were
}
WITHOUT_VALUES = ("gust",)  # its intensity is a realisation's, not a parameter's


class Outcome(StrEnum):
    """The five outcomes of a case, the best first.

    RIGHT: names what is hidden, each effect by itself, and nothing else; explains flights that hide nothing; or gives
        an answer that the case declares right, such as `unknown` for a force that no catalogue has.
    DECLARED: the truth is among the effects that are declared to look alike, or named beside an `unknown`.
    SILENT: nothing false, but hidden effects are not named, or the answer is refused.
    WRONG: an effect that is not there, none of its declared look-alikes being there either; `unknown` where nothing
        is missing; an answer that ended in an unexpected error.
    SURE_AND_WRONG: such an effect with a confidence of 90 % or more.
    """

    RIGHT = "right"
    DECLARED = "declared"
    SILENT = "silent"
    WRONG = "wrong"
    SURE_AND_WRONG = "sure and wrong"


class Expected(msgspec.Struct, frozen=True, omit_defaults=True):
    """The truth of a case.

    hidden: effects that the vehicle has and the file has not or has otherwise, with parameters; `rotor` among them.
    required: those of them that an answer must name; the others show too little, or not in this kind of log.
    also: names that are no falsehood either.
    allowed: words that are right by themselves: "unknown" for what is in no catalogue, "refused" for logs that cannot
        answer.
    outside: whether something is missing that is in no catalogue.
    """

    hidden: Mapping[str, Mapping[str, float]] = {}
    required: tuple[str, ...] = ()
    also: tuple[str, ...] = ()
    allowed: tuple[str, ...] = ()
    outside: bool = False


class HeldStatement(msgspec.Struct, frozen=True):
    """A statement about a real flight.

    forbids: whether it forbids something; others demand.
    holds, holds_of_sure: of the answer; of the answer with its sure effects alone.
    """

    text: str
    forbids: bool
    holds: bool
    holds_of_sure: bool


class Answer(msgspec.Struct, frozen=True, omit_defaults=True):
    """The answer to a case.

    report: as `alula diagnose --json` has it, empty without one.
    refusal: message of an answer that was declined (exit 2 or 3).
    error: of an answer that ended unexpectedly.
    statements: about a real flight whose truth is not known.
    """

    report: Mapping[str, Any] = {}
    refusal: str = ""
    error: str = ""
    statements: tuple[HeldStatement, ...] = ()

    @property
    def word(self) -> str:
        """The verdict, "refused" or "error"."""
        return "error" if self.error else "refused" if self.refusal else str(self.report["verdict"])

    @property
    def effects(self) -> Sequence[Mapping[str, Any]]:
        """Effects that are named, in any verdict."""
        effects: Sequence[Mapping[str, Any]] = self.report.get("effects", ())
        return effects

    @property
    def gain_names(self) -> frozenset[str]:
        """Effects that are declared to be behind a gain of the motor commands."""
        return frozenset((self.report.get("command_gain") or {}).get("look_alikes", ()))


def outcome_of(answer: Answer, expected: Expected) -> Outcome:
    """The outcome of an answer."""
    if answer.error:
        return Outcome.WRONG
    if answer.statements:
        return _of_statements(answer.statements)
    if false := [effect for effect in answer.effects if not is_true(effect, expected)]:
        return Outcome.SURE_AND_WRONG if any(e["confidence"] >= SURE for e in false) else Outcome.WRONG
    if answer.word in expected.allowed:
        return Outcome.RIGHT
    if answer.word == "refused":
        return Outcome.SILENT
    missing = bool(expected.hidden) or expected.outside
    if (answer.word == "unknown" and not missing) or _is_false_gain(answer, expected):
        return Outcome.WRONG
    if unnamed(answer, expected) or (expected.outside and not expected.hidden):
        return Outcome.SILENT
    if answer.word == "unknown":
        return Outcome.DECLARED if answer.effects else Outcome.SILENT
    alone = all(any(_is_named_alone(e, name, expected) for e in answer.effects) for name in expected.required)
    return Outcome.RIGHT if alone else Outcome.DECLARED


def is_true(effect: Mapping[str, Any], expected: Expected) -> bool:
    """Whether a named effect is hidden, on its rotor, or declared to look like one that is."""
    names = {effect["name"], *effect["ambiguous_with"]}
    return bool(names & set(expected.also)) or any(_covers(effect, name, expected) for name in expected.hidden)


def unnamed(answer: Answer, expected: Expected) -> list[str]:
    """Required effects that are neither named nor declared."""
    return [
        name
        for name in expected.required
        if not any(_covers(effect, name, expected) for effect in answer.effects)
        and not answer.gain_names & set(_names(name))
    ]


def intervals(answer: Answer, expected: Expected) -> list[bool]:
    """Of each parameter that was fitted of a hidden effect: whether its 95 % interval holds the truth."""
    held = []
    for effect in answer.effects:
        name, hidden = effect["name"], expected.hidden.get(effect["name"], {})
        parameters = effect["parameters"]
        if name in WITHOUT_VALUES or not _is_on_rotor(effect, hidden) or not _has_true_shape(parameters, hidden):
            continue
        for key, parameter in parameters.items():
            if parameter["std"] > 0 and key in hidden:
                held.append(abs(parameter["value"] - hidden[key]) <= DEVIATIONS * parameter["std"])
    return held


def _of_statements(statements: Sequence[HeldStatement]) -> Outcome:
    broken = [s for s in statements if not s.holds]
    if not broken:
        return Outcome.RIGHT
    if any(s.forbids and not s.holds_of_sure for s in broken):
        return Outcome.SURE_AND_WRONG
    return Outcome.WRONG if any(s.forbids for s in broken) else Outcome.SILENT


def _is_false_gain(answer: Answer, expected: Expected) -> bool:
    """Whether a gain of the commands is said to hide effects, none of which is there, while none is named."""
    true = {*expected.also, *(name for hidden in expected.hidden for name in _names(hidden))}
    return bool(answer.gain_names) and not answer.effects and not answer.gain_names & true


def _is_named_alone(effect: Mapping[str, Any], name: str, expected: Expected) -> bool:
    return not effect["ambiguous_with"] and _covers(effect, name, expected)


def _covers(effect: Mapping[str, Any], name: str, expected: Expected) -> bool:
    """Whether a named effect is this hidden one on its rotor, or declared to look like it."""
    if effect["name"] in _names(name):
        return _is_on_rotor(effect, expected.hidden[name])
    return bool(set(effect["ambiguous_with"]) & set(_names(name)))


def _names(hidden: str) -> tuple[str, ...]:
    return NAMES.get(hidden, (hidden,))


def _is_on_rotor(effect: Mapping[str, Any], hidden: Mapping[str, float]) -> bool:
    return effect["rotor"] is None or "rotor" not in hidden or int(hidden["rotor"]) == effect["rotor"]


def _has_true_shape(parameters: Mapping[str, Any], hidden: Mapping[str, float]) -> bool:
    """Whether parameters that were held, not fitted, are the true ones."""
    held = {key: p["value"] for key, p in parameters.items() if p["std"] == 0 and key in hidden}
    return all(abs(value - hidden[key]) <= HELD_SHAPE * abs(hidden[key]) for key, value in held.items())
