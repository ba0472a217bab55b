"""The next vehicle file from what a model followed in flight, and what is left out of it."""

from __future__ import annotations

import dataclasses

import msgspec
import numpy as np
import pytest

from diagnosis.flight_addition import FlightAddition, add_followed, flight_report, left_out_sentence
from dynamics.effects import CATALOGUE
from dynamics.errors import DataError, RequestError
from dynamics.vehicle import EffectUse, Vehicle
from flights.followed import FollowedFlight
from tests.diagnosis.test_in_flight import DRAG, followed_flight

WIND = {"wind.x": (8.0, 0.5, 9.0), "wind.y": (0.0, 0.5, 9.0), "wind.z": (0.0, 2.9, 3.0)}


def added(flight: FollowedFlight, vehicle: Vehicle, effect: str | None = None) -> FlightAddition:
    return add_followed(flight, vehicle, CATALOGUE, None, effect=effect, date="2026-01-02", command="alula add")


def test_what_surely_changed_is_in_the_next_file_and_its_history(arpl_250g: Vehicle) -> None:
    flight = followed_flight(arpl_250g, DRAG | {"parasitic_drag.coefficient": (0.001, 0.004, 0.03)})
    result = added(flight, arpl_250g)
    assert result.vehicle.effects == (EffectUse("rotor_drag", {"coefficient": 2.4e-5}),)
    (entry,) = result.vehicle.history
    assert (entry.action, entry.flights) == ("added rotor_drag, as followed in flight", ("flight.mcap " + 16 * "0",))
    (left_out,) = result.left_out
    assert (left_out.effect, left_out.why) == ("parasitic_drag", "no_change")
    assert "were not compared" in result.notes[0]
    assert flight_report(result, flight).effects == ("rotor_drag",)


def test_an_effect_of_the_file_is_corrected(arpl_250g: Vehicle) -> None:
    own = arpl_250g.with_effects(EffectUse("rotor_drag", {"coefficient": 1e-5}), EffectUse("mass", {"ratio": 1.1}))
    result = added(followed_flight(own, DRAG | {"mass.ratio": (1.12, 0.02, 0.3)}), own)
    assert [use.parameters for use in result.vehicle.effects] == [{"coefficient": 2.4e-5}, {"ratio": 1.1}]
    assert result.vehicle.history[-1].action == "corrected rotor_drag, as followed in flight"


def test_the_wind_of_a_flight_is_added_where_it_is_named_alone(arpl_250g: Vehicle) -> None:
    flight = followed_flight(arpl_250g, DRAG | WIND)
    result = added(flight, arpl_250g)
    assert [use.name for use in result.vehicle.effects] == ["rotor_drag"]
    assert "is the air of that flight" in left_out_sentence(result.left_out[0])
    (wind,) = added(flight, arpl_250g, "wind").vehicle.effects
    assert wind.parameters == {"x": 8.0, "y": 0.0, "z": 0.0, "coefficient": 0.0}


def test_a_rotor_that_lost_thrust_in_flight_lost_it_of_what_it_had(arpl_250g: Vehicle) -> None:
    own = arpl_250g.with_effects(EffectUse("weak_rotor", {"loss": 0.1, "torque_loss": 0.05}, 2))
    flight = followed_flight(own, {"weak_rotor[2].loss": (0.2, 0.02, np.inf)})
    (use,) = added(flight, own).vehicle.effects
    assert use.rotor == 2
    assert use.parameters == pytest.approx({"loss": 0.28, "torque_loss": 0.05})


def test_shadow_and_distrust_are_noted(arpl_250g: Vehicle) -> None:
    notes = " ".join(added(followed_flight(arpl_250g, DRAG, mode="shadow", trust=0.0), arpl_250g).notes)
    assert "estimated in shadow" in notes
    assert "did not trust" in notes


@pytest.mark.parametrize(
    ("values", "reason"),
    [
        ({"rotor_drag.coefficient": (1e-6, 2e-6, 4e-5)}, "holds the vehicle file's value"),
        ({"wind.x": (0.1, 8.0, 9.0)}, "the flight did not show it"),
        (
            {"mass.ratio": (1.0, 0.02, 0.3)},
            r"in its effectiveness, 0\.870 ± 0\.020 of .* alone, mass would be 1\.149",
        ),
        ({}, "followed a disturbance and no effect by name"),
    ],
)
def test_nothing_to_add_is_an_error_with_the_reason(
    arpl_250g: Vehicle, values: dict[str, tuple[float, float, float]], reason: str
) -> None:
    with pytest.raises(DataError, match=reason):
        added(followed_flight(arpl_250g, values), arpl_250g)


def test_another_vehicle_s_flight_is_refused(arpl_250g: Vehicle) -> None:
    flight = followed_flight(arpl_250g, DRAG)
    heavier = msgspec.structs.replace(arpl_250g, body=msgspec.structs.replace(arpl_250g.body, mass=0.3))
    with pytest.raises(RequestError, match=r"body\.mass was 0\.25 in flight and is 0\.3 in the file\. What was"):
        added(flight, heavier)
    following = added(flight, arpl_250g).vehicle
    with pytest.raises(RequestError, match="rotor_drag was not there in flight"):
        added(flight, following)
    with pytest.raises(RequestError, match=r"mass was not followed in this flight\. It followed rotor_drag"):
        added(flight, arpl_250g, "mass")
    with pytest.raises(RequestError, match="holds no vehicle file"):
        added(dataclasses.replace(flight, vehicle=""), arpl_250g)
    with pytest.raises(RequestError, match="is damaged"):
        added(dataclasses.replace(flight, vehicle="name = "), arpl_250g)


def test_a_controller_of_its_own_is_no_other_vehicle(arpl_250g: Vehicle) -> None:
    controller = msgspec.structs.replace(arpl_250g.controller, horizon=0.8)
    tuned = msgspec.structs.replace(arpl_250g, controller=controller, name="tuned")
    assert added(followed_flight(arpl_250g, DRAG), tuned).vehicle.name == "tuned"
