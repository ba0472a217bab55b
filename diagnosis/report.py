"""A diagnosis as `alula diagnose --json` writes it, and in one sentence."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Literal

import msgspec

from diagnosis.estimation.refusal import Refused, reason_of
from diagnosis.likelihood.held_out_score import HeldOutScore
from diagnosis.models.channels import channel_name
from diagnosis.regimes import Failure

Verdict = Literal["explained", "effect", "ambiguous", "unknown"]
Outcome = Literal["named", "refused", "not_selected", "impossible"]
InFlightOutcome = Literal["agrees", "differs", "not_estimated"]
MOSTLY = 0.995  # a probability that is not written as 100 %


class ParameterValue(msgspec.Struct, frozen=True):
    """A fitted parameter with its standard deviation."""

    value: float
    std: float
    unit: str


class MissingEffect(msgspec.Struct, frozen=True):
    """An effect that is missing from the model.

    name, rotor: of the catalogue, and the rotor that it sits on, if any.
    parameters: fitted, or held with a standard deviation of 0.
    confidence: probability that it, or one of `ambiguous_with`, is there beside the other effects.
    ambiguous_with: effects that these flights cannot tell from it.
    by_resamples: whether the confidence is a share of flight resamples, as that of a gain of commands.
    """

    name: str
    rotor: int | None
    parameters: dict[str, ParameterValue]
    confidence: float
    ambiguous_with: tuple[str, ...]
    by_resamples: bool = False


class Considered(msgspec.Struct, frozen=True):
    """An effect of the catalogue as these flights show it.

    name, rotor: of the catalogue, and the rotor that it acts on, if any.
    score: log of the odds of the named effects with it against those without it, of which 3 name an effect; null where
        the values that fit best are physically impossible.
    outcome: "named", "refused" (`Diagnosis.refused` has the reason), "not_selected" where others explain the flights
        better or nothing is missing, "impossible".
    """

    name: str
    rotor: int | None
    score: float | None
    outcome: Outcome


class ChannelError(msgspec.Struct, frozen=True):
    """RMS over the three axes on held-out flights, before and after.

    floor: what no effect of the catalogue lowers: noise of the sensors, and the fast remainder.
    sensors: the sensors' noise alone, as it is heard where no motion reaches.
    fast_remainder: the rest of the floor, such as the rotors' turbulence.
    """

    before: float
    after: float
    floor: float
    unit: str
    sensors: float
    fast_remainder: float

    @property
    def at_sensors(self) -> bool:
        """Whether the floor is the sensors' noise, and not mostly a remainder."""
        return self.sensors > self.fast_remainder


class Seconds(msgspec.Struct, frozen=True):
    """A window of a flight. start, stop: s in the log's time; over_floor: RMS in it over the channel's floor."""

    flight: str
    start: float
    stop: float
    over_floor: float


class Leftover(msgspec.Struct, frozen=True):
    """A leftover beside the effects, for which the verdict is unknown.

    test: what predicts it: "predictable_from_state", "position_dependent", "predictable_from_time", "spectral_line".
    channel: in which it is largest, such as "imu x".
    size, threshold: log of the odds that it is there, and those that are required.
    rms: of it, in unit. over_floor: the same over the floor of the channel.
    frequency: of a line, Hz.
    seconds: where it is largest.
    regimes: cells in which it stands out, over its own mean.
    """

    test: str
    channel: str
    size: float
    threshold: float
    rms: float
    over_floor: float
    unit: str
    frequency: float | None
    seconds: tuple[Seconds, ...]
    regimes: tuple[Failure, ...]


class CommandGain(msgspec.Struct, frozen=True):
    """Thrust over that which the vehicle file gives for the motor commands, where no rotor speed was measured.

    value, std: over all flights, fitted beside the effects that are named.
    look_alikes: effects that show as nothing but such a gain, where it is surely not 1 and none of them was found by
        anything else. The first of them is then named beside the others, unless something else is left.
    """

    value: float
    std: float
    look_alikes: tuple[str, ...]


class FollowedParameter(msgspec.Struct, frozen=True):
    """A parameter as a model followed it in flight, and as the diagnosis has it.

    value, std: at the end of tracking.
    shown: whether the flight showed it: its interval is much narrower than before the flight.
    diagnosed, diagnosed_std: of the model with the effects that are named; 0 for a value that was not fitted.
    """

    value: float
    std: float
    unit: str
    shown: bool
    diagnosed: float
    diagnosed_std: float


class FollowedEffect(msgspec.Struct, frozen=True):
    """An effect as the model of a recorded flight followed it, beside the diagnosis.

    flight: file of the recording.
    name, rotor: of the catalogue, and the rotor that it acts on, if any.
    outcome: "agrees", "differs", or "not_estimated" where the flight did not follow or did not show it.
    named: whether the diagnosis names it as missing.
    parameters: those that were followed; empty where none was.
    reason: why it differs or was not estimated, in words; empty where it agrees.
    """

    flight: str
    name: str
    rotor: int | None
    outcome: InFlightOutcome
    named: bool
    parameters: dict[str, FollowedParameter]
    reason: str = ""


class Diagnosis(msgspec.Struct, frozen=True):
    """The verdict and its evidence.

    effects: that are missing, the most important first.
    channels: errors by kind of channel.
    not_excited: effects that would not have shown at their usual size.
    fails_where: cells in which the model fails most.
    next_flight: the manoeuvre to fly next.
    next_reference: of the identification flight for the effects that are open, as `alula fly --reference` takes it;
        empty where none is.
    refused: effects that were selected and are not named, each with its reason.
    candidates: what was tried, the best first.
    leftover: what no effect of the catalogue explains, the largest first.
    rotors: each rotor's name with its place and the autopilots' numbers, for people.
    command_gain: None where rotor speeds were measured.
    in_flight: what the models of recorded flights followed, beside what is diagnosed; empty where none did.
    held_out_score: log score of one-step predictions on held-out flights; None where no filter can follow them.
    """

    verdict: Verdict
    effects: tuple[MissingEffect, ...]
    channels: dict[str, ChannelError]
    not_excited: tuple[str, ...]
    fails_where: tuple[Failure, ...]
    next_flight: str
    refused: tuple[Refused, ...] = ()
    candidates: tuple[Considered, ...] = ()
    leftover: tuple[Leftover, ...] = ()
    rotors: tuple[str, ...] = ()
    next_reference: str = ""
    command_gain: CommandGain | None = None
    in_flight: tuple[FollowedEffect, ...] = ()
    held_out_score: HeldOutScore | None = None


def _ground(errors: Mapping[str, ChannelError]) -> str:
    """Composition of an explained residual, in words."""
    fast = [kind for kind, error in errors.items() if not error.at_sensors]
    if not fast:
        return "the sensors' noise"
    names = " and ".join(map(channel_name, fast))
    return f"a residual that no catalogued effect explains, in {names} mostly fast and above the sensors' noise"


def sentence(diagnosis: Diagnosis) -> str:
    """The verdict in one sentence, and a second one on a gain of the commands that may be an effect."""
    return _verdict_sentence(diagnosis) + _gain_sentence(diagnosis.command_gain)


def _gain_sentence(gain: CommandGain | None) -> str:
    if gain is None or not gain.look_alikes:
        return ""
    return (
        f" The rotors give {gain.value:.3g} ± {1.96 * gain.std:.2g} times the thrust that the file gives for their "
        f"commands. Possible causes: {' or '.join(gain.look_alikes)}; motor commands alone cannot separate them from "
        "the motors' own gain."
    )


def _verdict_sentence(diagnosis: Diagnosis) -> str:
    if diagnosis.verdict == "explained":
        return f"The model explains these flights down to {_ground(diagnosis.channels)}."
    named = [_described(effect, diagnosis) + _look_alikes(effect) for effect in diagnosis.effects]
    missing = ("; and " if any(effect.ambiguous_with for effect in diagnosis.effects) else " and ").join(named)
    if diagnosis.verdict == "unknown":
        partly = f" Part of it looks like {missing}." if missing else ""
        left = f" ({leftover_sentence(diagnosis.leftover[0])})" if diagnosis.leftover else ""
        return f"Something is missing that no effect of the catalogue explains{left}.{partly}"
    return f"The model misses {missing}."


def refusal_sentence(refused: Refused, rotors: Sequence[str] = ()) -> str:
    """An effect that is not named, with its fitted values, and why. rotors: their names, as in the report."""
    values = ", ".join(f"{name} = {value:.4g}" for name, value in refused.parameters.items())
    where = _of_rotor(refused.rotor, rotors)
    return f"{refused.name}{where}{f' ({values})' if values else ''}: {reason_of(refused)}"


def score_sentence(score: HeldOutScore) -> str:
    """Log score on held-out flights and whether it rose beyond chance, without a full stop."""
    where = f"{score.seconds:.0f} s of held-out flight, chi-square {score.chi_square:.3g}"
    if score.gain == 0:
        return f"One-step log score on {where}: {score.before:.1f} {score.unit}"
    chance = 1.96 * score.gain_std
    change = "no change beyond chance" if abs(score.gain) <= chance else "better" if score.gain > 0 else "worse"
    return (
        f"One-step log score on {where}: {score.before:.1f} {score.unit} before, {score.after:.1f} after, {change} "
        f"({score.gain:+.3g} ± {chance:.2g})"
    )


def in_flight_sentence(followed: FollowedEffect, rotors: Sequence[str] = ()) -> str:
    """An effect in flight beside the diagnosis, without a full stop. rotors: their names, as in the report."""
    name = followed.name + _of_rotor(followed.rotor, rotors)
    if followed.outcome == "not_estimated":
        return f"{name} was not estimated in flight: {followed.reason}"
    shown = {key: p for key, p in followed.parameters.items() if p.shown}
    values = ", ".join(_value_text(key, p.value, p.std, p.unit) for key, p in shown.items())
    diagnosed = ", ".join(_value_text(key, p.diagnosed, p.diagnosed_std, p.unit) for key, p in shown.items())
    fitted = followed.named or any(p.diagnosed_std for p in shown.values())
    counterpart = (
        f"{diagnosed} diagnosed" if fitted else f"{diagnosed} in the model, which the diagnosis leaves as it is"
    )
    reason = f"; {followed.reason}" if followed.reason else ""
    return f"{name} {followed.outcome}: {values} in flight, {counterpart}{reason}"


def _value_text(name: str, value: float, std: float, unit: str) -> str:
    interval = f" ± {1.96 * std:.2g}" if std else ""
    return f"{name} = {value:.4g}{interval}{'' if unit == '1' else f' {unit}'}"


REMAINS = {
    "predictable_from_state": "what remains depends on the state",
    "position_dependent": "what remains repeats at the same places",
    "predictable_from_time": "what remains changes with the time of flight",
    "spectral_line": "a line remains in the spectrum",
}


def remains(leftover: Leftover) -> str:
    """A leftover in words."""
    line = "" if leftover.frequency is None else f" at {leftover.frequency:.2g} Hz"
    return f"{REMAINS.get(leftover.test, leftover.test)}{line}"


def leftover_sentence(leftover: Leftover) -> str:
    """A leftover, its channel and its size, without a full stop."""
    return (
        f"{remains(leftover)}, in {channel_name(leftover.channel)} {leftover.rms:.2g} {leftover.unit} RMS or "
        f"{leftover.over_floor:.2g} times its floor"
    )


def evidence_sentence(leftover: Leftover) -> str:
    """How sure it is, when and where it is largest, without a full stop."""
    when = [f"{Path(s.flight).name} {s.start:.1f} to {s.stop:.1f} s" for s in leftover.seconds[:2]]
    where = [f"{cell.regime} {cell.low:.3g} to {cell.high:.3g}" for cell in leftover.regimes[:2]]
    largest = f"; largest in {', '.join(when)}" if when else ""
    cells = f"; at {', '.join(where)}" if where else ""
    return f"log of the odds {leftover.size:.3g}, required {leftover.threshold:.3g}{largest}{cells}"


def _look_alikes(effect: MissingEffect) -> str:
    if not effect.ambiguous_with:
        return ""
    return f" or else {' or '.join(effect.ambiguous_with)}, which these flights cannot tell from it"


def _of_rotor(rotor: int | None, rotors: Sequence[str]) -> str:
    """The rotor on which an effect acts, by its name where there is one."""
    if rotor is None:
        return ""
    return f" of {rotors[rotor]}" if rotor < len(rotors) else f" of rotor {rotor}"


def _described(effect: MissingEffect, diagnosis: Diagnosis) -> str:
    where = _of_rotor(effect.rotor, diagnosis.rotors)
    values = ", ".join(_value_text(name, p.value, p.std, p.unit) for name, p in effect.parameters.items())
    return f"{effect.name}{where} ({values}; {confidence_in_words(effect)})"


def confidence_in_words(effect: MissingEffect) -> str:
    """Confidence in words, with its number."""
    confidence = effect.confidence
    if effect.by_resamples:
        return f"{100 * confidence:.0f} % of flight resamples agree"
    return "probability above 99 %" if confidence > MOSTLY else f"probability {100 * confidence:.0f} %"
