"""Reading logs into a data set."""

from pathlib import Path

import numpy as np
import pytest

from diagnosis.data import dataset
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
