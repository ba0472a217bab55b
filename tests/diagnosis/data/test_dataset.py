"""Reading logs into a data set."""

from pathlib import Path

import numpy as np
import pytest

from diagnosis.data import dataset
from flights import Flight


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
