"""The picture of what a model followed: a band for each parameter, the diagnosis beside it, rotors that are named."""

from __future__ import annotations

import base64
import json
from typing import Any

import numpy as np
import pytest

from diagnosis.report import FollowedEffect, FollowedParameter
from dynamics.vehicle import Vehicle
from studio.pages.followed import followed_picture
from tests.diagnosis.test_in_flight import DRAG, followed_flight


def numbers(packed: dict[str, Any]) -> np.ndarray:
    """A line's numbers, as Plotly packs them."""
    return np.frombuffer(base64.b64decode(packed["bdata"]), packed["dtype"])


def test_a_parameter_has_its_interval_its_unit_and_the_diagnosis(arpl_250g: Vehicle) -> None:
    value = FollowedParameter(2.4e-5, 2e-6, "N s^2/(rad m)", True, 2.2e-5, 1e-7)
    effect = FollowedEffect("flight.mcap", "rotor_drag", None, "agrees", True, {"coefficient": value})
    drawn = json.loads(followed_picture(followed_flight(arpl_250g, DRAG), [effect]).data)
    titles = [annotation["text"] for annotation in drawn["layout"]["annotations"]]
    assert titles == ["rotor_drag.coefficient, N s²/(rad m)", "disturbance, m/s²", "disturbance, rad/s²"]
    (dashed,) = [shape for shape in drawn["layout"]["shapes"] if shape["line"]["dash"] == "dash"]
    assert dashed["y0"] == 2.2e-5
    band = next(trace for trace in drawn["data"] if trace.get("fill"))
    assert numbers(band["y"]).max() == pytest.approx(1.96 * 4e-5)  # of the prior, which the panel's range leaves out
    low, high = drawn["layout"]["yaxis"]["range"]
    assert -1e-5 < low < 2e-5 < high < 4e-5


def test_a_rotor_that_is_named_late_and_a_flight_without_parameters_are_drawn(arpl_250g: Vehicle) -> None:
    flight = followed_flight(arpl_250g, {"weak_rotor[2].loss": (0.14, 0.02, 0.02)})
    flight.value[0] = flight.deviation[0] = np.nan
    drawn = json.loads(followed_picture(flight).data)
    band = next(trace for trace in drawn["data"] if trace.get("fill"))
    assert len(numbers(band["x"])) == 4
    assert "Lines" in followed_picture(followed_flight(arpl_250g, {})).description


def test_a_network_that_follows_has_its_change_and_its_forecasts(arpl_250g: Vehicle) -> None:
    flight = followed_flight(arpl_250g, {})
    flight.network[1:] = 0.1, 0.2, 0.3, 0.4, 0.5
    drawn = json.loads(followed_picture(flight).data)
    titles = [annotation["text"] for annotation in drawn["layout"]["annotations"]]
    assert titles[-2:] == ["change of the network's last layer, m/s²", "forecast errors, m/s²"]
    assert {"with the change", "without"} <= {trace["name"] for trace in drawn["data"]}
