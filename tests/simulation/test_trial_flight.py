"""A planned manoeuvre is flown on the mock before the vehicle flies it."""

from __future__ import annotations

import pytest

from alula.api import planning
from alula.api.planning import plan_flight
from dynamics.errors import VehicleError
from dynamics.references import named_reference
from dynamics.vehicle import Vehicle
from simulation.trial_flight import TrialFlight, fly_trial

REQUEST = "identify:duration=10,for=rotor_drag"


@pytest.fixture
def few_trials(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("diagnosis.experiment.expectation.TRIALS", (12, 12))


def test_a_manoeuvre_that_the_mock_flies_is_near_its_reference(arpl_250g: Vehicle) -> None:
    trial = fly_trial(arpl_250g, named_reference("circle:laps=1,speed=1.5", arpl_250g))
    assert trial.succeeded, trial.text
    assert trial.position_rmse < 0.1


def test_what_the_mock_cannot_follow_is_planned_slower_or_refused(
    arpl_250g: Vehicle, few_trials: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    results = [TrialFlight(0.4, 0.9), TrialFlight(0.1, 0.2, "impact"), TrialFlight(0.1, 0.2)]
    monkeypatch.setattr("simulation.trial_flight.fly_trial", lambda *_: results.pop(0))
    planned = plan_flight(arpl_250g, REQUEST, trial=False)
    flown = plan_flight(arpl_250g, REQUEST)
    assert (planned.pace, flown.pace) == (1.0, 0.8)
    assert flown.plan.lap.rate == pytest.approx(0.8 * planned.plan.lap.rate)
    assert flown.plan.reference.duration == planned.plan.reference.duration
    assert flown.plan.expected[0].std > planned.plan.expected[0].std
    results += [TrialFlight(0.1, 0.2, "impact")] * len(planning.PACES)
    with pytest.raises(VehicleError, match=r"mock of arpl_250g cannot fly .* impact"):
        plan_flight(arpl_250g, REQUEST)
