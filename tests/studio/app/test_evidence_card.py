"""The evidence's picture: score and interval of a parameter's values, and the error for each of them."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from dash import no_update

from studio.app import evidence_card
from studio.app.evidence_card import _errors_figure
from studio.work.results import GRID, Slider

ERRORS = [[1.0, None, 2.0, 3.0]] * GRID


def slider(std: float) -> Slider:
    return Slider("coefficient", "N s/m", np.linspace(0.0, 4.0, GRID).tolist(), GRID // 2, std, ERRORS)


def test_the_score_falls_from_the_best_value_to_that_of_the_interval_at_its_ends() -> None:
    figure = _errors_figure(slider(0.25), 3.0, "light")
    score = next(trace for trace in figure.data if trace.name == "score")
    assert score.x[int(np.argmax(score.y))] == pytest.approx(2.0)
    best, chosen, interval = figure.layout.shapes  # a moved slider moves the second
    assert (best.x0, chosen.x0) == (2.0, pytest.approx(0.75))
    for end in (interval.x0, interval.x1):
        assert np.interp(end, score.x, score.y) == pytest.approx(-(1.96**2) / 2, abs=0.01)


def test_a_value_that_was_not_fitted_has_errors_and_no_score() -> None:
    figure = _errors_figure(slider(0.0), 3.0, "light")
    assert {trace.name for trace in figure.data}.isdisjoint({"score"})
    assert len(figure.data) == 3
    assert len(figure.layout.shapes) == 2


def test_a_card_with_its_result_is_not_drawn_again_when_the_job_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its lines, which a slider draws into it, were gone then."""
    opened = SimpleNamespace(
        job=SimpleNamespace(step="explain:mass"),
        case=SimpleNamespace(key=lambda _: "state", has_result=lambda _: True),
        failure=None,
        refusal=lambda _: None,
        result=lambda *_, **__: "result",
    )
    monkeypatch.setattr(evidence_card, "opened_at", lambda *_: opened)
    monkeypatch.setattr(evidence_card, "_evidence", lambda *_: "card")
    first = evidence_card._show(None, [{"key": "mass"}], 1, None, "/case/a", "light")
    assert first[0] == "card"
    opened.job = None
    assert evidence_card._show(None, [{"key": "mass"}], 2, first[1], "/case/a", "light") == (no_update, no_update)
