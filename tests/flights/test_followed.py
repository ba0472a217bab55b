"""Parameters that a model followed in flight, from recordings: complete, torn, and of rotors that are named later."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import msgspec
import numpy as np
import pytest

from dynamics.errors import DataError, RequestError
from flights.followed import read_followed, require_followed
from runtime.record.files import McapFile, SafeFile
from runtime.record.records import FollowedRecord, PhaseRecord, Record

CONTROLLER = '{"adaptation": {"mode": "shadow", "follow": ["mass"]}, "period": 0.01}'


def followed_record(time: float, values: dict[str, tuple[float, float]], trust: float = 1.0) -> FollowedRecord:
    numbers = np.array(list(values.values())).reshape(-1, 2)
    names = " ".join(values)
    record = FollowedRecord(time, np.ones(6), np.ones(6), np.array([trust, 1.0]), names, numbers[:, 0], numbers[:, 1])
    return msgspec.structs.replace(record, effectiveness=0.9, effectiveness_deviation=0.02)


def written(path: Path, records: Sequence[Record], metadata: dict[str, str] | None = None) -> Path:
    file = SafeFile(path)
    mcap = McapFile(file, metadata or {"controller": CONTROLLER}, {"vehicle.toml": "name = 'quad'"})
    for record in records:
        mcap.add(record, round(1e9 * record.time))
    mcap.finish()
    file.close()
    return path


def flight(path: Path) -> Path:
    """Tracks from 11 to 13 s; rotor 2 is named at 12 s; at 14 s it lands."""
    mass = [(1.0, 0.3), (1.1, 0.1), (1.2, 0.05), (1.4, 0.2)]
    rows: list[Record] = [PhaseRecord(11.0, "track", "{}"), PhaseRecord(13.5, "return", "{}")]
    for second, pair in enumerate(mass):
        named = {"mass.ratio": pair} | ({"weak_rotor[2].loss": (0.15, 0.02)} if second >= 2 else {})
        rows.append(followed_record(11.0 + second, named))
    return written(path, rows)


def test_values_are_those_at_the_end_of_tracking(tmp_path: Path) -> None:
    followed = require_followed(flight(tmp_path / "a.mcap"))
    assert (followed.mode, followed.vehicle) == ("shadow", "name = 'quad'")
    assert followed.time.tolist() == [0.0, 1.0, 2.0, 3.0]
    assert followed.tracked.tolist() == [True, True, True, False]
    assert followed.values["mass.ratio"] == (1.2, 0.05, 0.3)
    assert followed.disturbance.shape == (4, 6)
    assert set(followed.disturbance.ravel()) == {2.0}
    assert set(followed.effectiveness_deviation) == {0.02}


def test_a_rotor_that_is_named_in_flight_is_there_from_then_on(tmp_path: Path) -> None:
    followed = require_followed(flight(tmp_path / "a.mcap"))
    assert followed.names == ("mass.ratio", "weak_rotor[2].loss")
    assert np.isnan(followed.value[:, 1]).tolist() == [True, True, False, False]
    assert followed.values["weak_rotor[2].loss"] == (0.15, 0.02, np.inf)  # it has no prior


def test_a_range_is_that_of_the_rows_that_show_a_parameter(tmp_path: Path) -> None:
    followed = require_followed(flight(tmp_path / "a.mcap"))
    ends = followed.range_of("mass.ratio", 0.5)
    assert ends is not None
    assert [end.value for end in ends] == [1.1, 1.2]
    assert followed.range_of("mass.ratio", 0.01) is None


def test_a_recording_that_is_cut_off_is_read_up_to_there(tmp_path: Path) -> None:
    path = flight(tmp_path / "a.mcap")
    torn = tmp_path / "torn.mcap"
    torn.write_bytes(path.read_bytes()[:-300])
    followed = read_followed(torn)
    assert followed is None or len(followed.time) <= 4
    torn.write_bytes(path.read_bytes()[:50])
    assert read_followed(torn) is None


def test_logs_without_are_none_and_refused_where_it_is_required(tmp_path: Path) -> None:
    table = tmp_path / "flight.csv"
    table.write_text("t,x\n0,1\n")
    bare = written(tmp_path / "off.mcap", [PhaseRecord(11.0, "track", "{}")])
    for path in (table, bare):
        assert read_followed(path) is None
        with pytest.raises(DataError, match="--adapt shadow or --adapt on"):
            require_followed(path)
    with pytest.raises(RequestError, match="cannot read"):
        read_followed(tmp_path / "none.mcap")


def test_numbers_that_do_not_fit_their_names_are_left_out(tmp_path: Path) -> None:
    good = followed_record(1.0, {"mass.ratio": (1.0, 0.1)})
    bad = FollowedRecord(2.0, np.ones(6), np.ones(6), np.ones(2), "mass.ratio wind.x", np.ones(1), np.ones(1))
    followed = require_followed(written(tmp_path / "a.mcap", [good, bad], {"controller": "{"}))
    assert len(followed.time) == 1
    assert followed.mode == ""


def test_the_change_of_a_network_s_last_layer_is_read_where_it_follows(tmp_path: Path) -> None:
    change, errors = np.array([0.1, 0.2, 0.3]), np.array([0.4, 0.5])
    record = msgspec.structs.replace(followed_record(12.0, {}), network_change=change, network_errors=errors)
    rows = [followed_record(11.0, {}), record]  # the first with a model without a network
    followed = require_followed(written(tmp_path / "a.mcap", rows))
    assert np.isnan(followed.network[0]).all()
    np.testing.assert_array_equal(followed.network[1], [0.1, 0.2, 0.3, 0.4, 0.5])
