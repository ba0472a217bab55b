"""Reading logs into a data set."""

from pathlib import Path

import numpy as np
import pytest

from diagnosis.data import dataset
from diagnosis.estimation.fitted import Fit, ParameterEstimate, with_candidates
from diagnosis.estimation.output_error import refit
from diagnosis.selection.regression_of_flights import make_regression
from dynamics.effects import CATALOGUE
from flights import Flight, read_log


def test_logs_of_different_rates_come_to_the_slowest_one_and_are_parsed_once(plain_flights, tmp_path, monkeypatch):
    fast, other = plain_flights[:2]
    slow = Flight(other.time[::2], {n: v[::2] for n, v in other.columns.items()}, other.provenance)
    paths = [fast.to_csv(tmp_path / "fast.csv"), slow.to_csv(tmp_path / "slow.csv")]
    parsed: list[str] = []
    read_log = dataset.read_log

    def counted(path, **options):
        parsed.append(Path(path).name)
        return read_log(path, **options)

    monkeypatch.setattr(dataset, "read_log", counted)
    flights = dataset.read_flights(paths)
    assert parsed == ["fast.csv", "slow.csv"]
    assert [flight.rate for flight in flights] == pytest.approx([slow.rate] * 2, rel=1e-3)
    assert np.isfinite(flights[0]["rate"]).all()


def _at(rate, flight, path):
    """A flight as a log of another rate."""
    return Flight.from_log(read_log(flight.to_csv(path)), rate=rate)


def _of_rates(rates, flights, vehicle, folder):
    """A data set of flights of different rates, the second one held out."""
    logged = [
        _at(rate, flight, folder / f"{i}.csv") for i, (rate, flight) in enumerate(zip(rates, flights[:2], strict=True))
    ]
    return dataset.make_dataset(logged, vehicle, hold_out="1.csv")


@pytest.mark.parametrize("rates", [(83.0, 88.0), (99.6, 100.0), (83.0 + 1e-7, 83.0)])
def test_a_data_set_has_one_rate_whatever_its_flights_had(rates, plain_flights, arpl_250g, tmp_path):
    data = _of_rates(rates, plain_flights, arpl_250g, tmp_path)
    rate = {segment.rate for segment in data.everything}
    assert len(rate) == 1
    assert rate.pop() == pytest.approx(min(rates), rel=1e-5)


def test_flights_of_different_rates_are_fitted_by_output_error(plain_flights, arpl_250g, tmp_path):
    """Half a second is 41.5 rows of 83 Hz: with rounding of the clocks one part had 41 and the other 42."""
    data = _of_rates((83.0, 88.0), plain_flights, arpl_250g, tmp_path)
    some = {name: CATALOGUE[name] for name in ("mass", "gyro_bias", "imu_bias", "time_delay")}
    regression = make_regression(arpl_250g, some, data.fitted, data.flight_of)
    mass = next(c for c in regression.candidates if c.effect.name == "mass")
    heavier = with_candidates(arpl_250g, [mass], {"mass.ratio": 1.02})
    started = Fit(heavier, {("mass", "ratio"): ParameterEstimate(1.02, 0.01, "1")}, (mass,))
    refitted = refit(started, arpl_250g, some, data.fitted, data.held_out)
    assert refitted is not None
    assert refitted.fit.estimates["mass", "ratio"].value == pytest.approx(1.0, abs=0.01)
