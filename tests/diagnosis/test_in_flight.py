"""What a model followed in flight beside a diagnosis: agrees, differs with the reason, or was not estimated."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import numpy as np
import pytest

from diagnosis.estimation.fitted import ParameterEstimate
from diagnosis.estimation.refusal import Refused
from diagnosis.in_flight import beside_diagnosis, constant_differences, effect_differences
from diagnosis.report import Diagnosis, FollowedEffect, MissingEffect, ParameterValue, in_flight_sentence
from dynamics.effects import CATALOGUE
from dynamics.vehicle import EffectUse, Vehicle
from dynamics.vehicle_file import vehicle_toml
from flights.followed import FollowedFlight

Values = dict[str, tuple[float, float, float]]
DRAG = {"rotor_drag.coefficient": (2.4e-5, 2e-6, 4e-5)}


def followed_flight(vehicle: Vehicle, values: Values, *, trust: float = 1.0, mode: str = "on") -> FollowedFlight:
    """A flight of three rows. values: by name, value and deviation at the end, deviation before the flight."""
    last = np.array(list(values.values())).reshape(-1, 3)
    value, deviation = np.zeros((3, len(last))), np.repeat(last[None, :, 2], 3, axis=0)
    value[1:], deviation[1:] = last[:, 0], last[:, 1]
    return FollowedFlight(
        path=Path("flight.mcap"),
        sha256="0" * 64,
        vehicle=vehicle_toml(vehicle),
        mode=mode,
        time=np.arange(3.0),
        names=tuple(values),
        value=value,
        deviation=deviation,
        disturbance=np.zeros((3, 6)),
        trust=np.array([[trust, 1.0]] * 3),
        effectiveness=np.full(3, 0.87),
        effectiveness_deviation=np.full(3, 0.01),
        tracked=np.ones(3, dtype=bool),
        network=np.full((3, 5), np.nan),
    )


def details(vehicle: Vehicle, *named: tuple[str, dict[str, tuple[float, float]]], **more: Any) -> Any:
    """A diagnosis that names effects with values and deviations."""
    effects, estimates = [], {}
    for name, parameters in named:
        values = {key: ParameterValue(value, std, "1") for key, (value, std) in parameters.items()}
        effects.append(MissingEffect(name, None, values, 1.0, ()))
        estimates |= {(name, key): ParameterEstimate(p.value, p.std, "1") for key, p in values.items()}
        vehicle = vehicle.with_effects(EffectUse(name, {key: p.value for key, p in values.items()}))
    quiet = more.pop("not_excited", ())
    diagnosis = Diagnosis("effect", tuple(effects), {}, quiet, (), "", **more)
    return SimpleNamespace(
        diagnosis=diagnosis, vehicle=vehicle, accepted=SimpleNamespace(fit=SimpleNamespace(estimates=estimates))
    )


def one(flight: FollowedFlight, result: Any) -> FollowedEffect:
    (effect,) = beside_diagnosis(flight, result, CATALOGUE)
    return effect


def test_overlapping_intervals_agree(arpl_250g: Vehicle) -> None:
    flight = followed_flight(arpl_250g, {"rotor_drag.coefficient": (2.4e-5, 2e-6, 4e-5)})
    effect = one(flight, details(arpl_250g, ("rotor_drag", {"coefficient": (2.2e-5, 1e-7)})))
    assert (effect.outcome, effect.named, effect.reason) == ("agrees", True, "")
    assert "2.4e-05 ± 3.9e-06 N s^2/(rad m) in flight, coefficient = 2.2e-05" in in_flight_sentence(effect)


def test_what_the_diagnosis_holds_is_not_compared(arpl_250g: Vehicle) -> None:
    flight = followed_flight(arpl_250g, {"wind.x": (4.0, 0.1, 9.0), "wind.z": (0.3, 0.1, 3.0)})
    effect = one(flight, details(arpl_250g, ("wind", {"x": (4.1, 0.02), "z": (0.0, 0.0)})))
    assert effect.outcome == "agrees"
    assert effect.parameters["z"].diagnosed_std == 0.0


def test_neither_sees_a_change(arpl_250g: Vehicle) -> None:
    effect = one(followed_flight(arpl_250g, {"mass.ratio": (1.01, 0.02, 0.3)}), details(arpl_250g))
    assert (effect.outcome, effect.named) == ("agrees", False)
    assert "ratio = 1 in the model, which the diagnosis leaves as it is" in in_flight_sentence(effect)


@pytest.mark.parametrize(
    ("values", "named", "more", "reason"),
    [
        (DRAG, (), {}, "explains the flights without it"),
        (
            DRAG,
            (),
            {"not_excited": ("rotor_drag",)},
            "excite it too little",
        ),
        (
            DRAG,
            (),
            {"refused": (Refused("rotor_drag", None, "unsure", {"odds": 3.0, "required": 20.0}),)},
            "does not name it: it is 3 times as likely as not",
        ),
        (
            DRAG,
            (("linear_drag", {"coefficient": (0.05, 0.001)}),),
            {},
            "names linear_drag instead, which looks like it",
        ),
        (
            {"rotor_drag.coefficient": (4.4e-5, 2e-6, 9e-5)},
            (("rotor_drag", {"coefficient": (2.2e-5, 1e-7)}),),
            {},
            "coefficient is 11.0 standard deviations away; nothing in the recording shows which is right",
        ),
        (
            {"mass.ratio": (1.0, 0.02, 0.3)},
            (("mass", {"ratio": (1.15, 0.01)}),),
            {},
            "0.870 ± 0.020 of the file's at the end: alone, mass would be 1.149 ± 0.026 of the file's",
        ),
    ],
)
def test_what_differs_has_its_reason(
    arpl_250g: Vehicle, values: Values, named: Any, more: dict[str, Any], reason: str
) -> None:
    effect = beside_diagnosis(followed_flight(arpl_250g, values), details(arpl_250g, *named, **more), CATALOGUE)[0]
    assert effect.outcome == "differs"
    assert reason in effect.reason
    assert reason in in_flight_sentence(effect)


def test_a_parameter_that_moves_in_flight_is_said_to(arpl_250g: Vehicle) -> None:
    flight = followed_flight(arpl_250g, {"mass.ratio": (1.2, 0.01, 0.3)})
    flight.value[2], flight.deviation[2] = 1.0, 0.01
    effect = one(flight, details(arpl_250g, ("mass", {"ratio": (1.1, 0.001)})))
    assert "ratio changed in flight, between 1 and 1.2, and the diagnosis has one value" in effect.reason


def test_what_was_not_trusted_in_flight_is_said(arpl_250g: Vehicle) -> None:
    flight = followed_flight(arpl_250g, {"rotor_drag.coefficient": (2.4e-5, 2e-6, 4e-5)}, trust=0.4)
    assert "forecast worse than the vehicle file's model" in one(flight, details(arpl_250g)).reason


def test_what_the_flight_did_not_show_or_follow_is_not_estimated(arpl_250g: Vehicle) -> None:
    flight = followed_flight(arpl_250g, {"wind.x": (0.1, 8.0, 9.0)})
    wind, mass = beside_diagnosis(flight, details(arpl_250g, ("mass", {"ratio": (1.1, 0.01)})), CATALOGUE)
    assert (wind.name, wind.outcome, mass.name, mass.outcome) == ("wind", "not_estimated", "mass", "not_estimated")
    assert "did not show it" in in_flight_sentence(wind)
    assert "not among the effects that were followed" in in_flight_sentence(mass)
    assert mass.parameters == {}
    learned = followed_flight(arpl_250g, {})
    assert "no effect was followed by name" in one(learned, details(arpl_250g, ("mass", {"ratio": (1.1, 0.01)}))).reason


def test_a_named_rotor_is_compared_with_the_rotor(arpl_250g: Vehicle) -> None:
    flight = followed_flight(arpl_250g, {"weak_rotor[2].loss": (0.14, 0.02, np.inf)})
    effect = one(flight, details(arpl_250g))
    assert (effect.name, effect.rotor, effect.outcome) == ("weak_rotor", 2, "differs")
    assert in_flight_sentence(effect).startswith("weak_rotor of rotor 2 differs: loss = 0.14")


def test_vehicles_are_compared_by_constants_and_effects(arpl_250g: Vehicle) -> None:
    heavier = msgspec.structs.replace(arpl_250g, body=msgspec.structs.replace(arpl_250g.body, mass=0.3))
    assert constant_differences(arpl_250g, heavier) == ["body.mass was 0.25 in flight and is 0.3 in the file"]
    dragged = arpl_250g.with_effects(EffectUse("rotor_drag", {"coefficient": 2e-5}))
    assert effect_differences(arpl_250g, dragged, CATALOGUE) == [
        "rotor_drag was not there in flight and is coefficient = 2e-05 in the file"
    ]
    usual = arpl_250g.with_effects(EffectUse("rotor_drag"))
    explicit = arpl_250g.with_effects(EffectUse("rotor_drag", CATALOGUE["rotor_drag"].defaults(arpl_250g)))
    assert effect_differences(usual, explicit, CATALOGUE) == []
