"""The gust that is a nuisance while effects are sought."""

from types import SimpleNamespace
from typing import Any

import pytest

from diagnosis.models.pose_errors import NO_ERRORS
from diagnosis.selection import selected
from diagnosis.selection.gust import Gust
from diagnosis.thresholds import DEFAULT


@pytest.mark.parametrize(("intensity", "variance"), [(1.5, 2.25), (DEFAULT.gust.intensity[1], 0.0)])
def test_the_strongest_gust_that_is_tried_is_none(
    monkeypatch: pytest.MonkeyPatch, intensity: float, variance: float
) -> None:
    """It is a force's, and leaves the forces nothing of slow motion."""
    regression: Any = SimpleNamespace(thresholds=DEFAULT, pose=NO_ERRORS)
    monkeypatch.setattr(selected, "gust_beside", lambda *_, **__: Gust(1e4, 1e4, intensity))
    assert selected.gust_variance(regression, ()) == pytest.approx(variance)
