"""What was computed of a segment is found again by value, is bounded, and ends with the segment."""

import dataclasses
import gc
import weakref

import msgspec
import numpy as np
import pytest

from diagnosis.data.segment import Segment, segments
from diagnosis.data.workspace import Workspace, key_of
from diagnosis.models import channels
from diagnosis.models.predictor import Predictor
from diagnosis.thresholds import DEFAULT
from dynamics.effects import CATALOGUE
from dynamics.vehicle import EffectUse, Vehicle


@pytest.fixture
def segment(plain_flights, arpl_250g: Vehicle) -> Segment:
    return segments(plain_flights[0], arpl_250g)[0]


def test_equal_keys_have_one_value() -> None:
    computed: list[float] = []
    workspace = Workspace()
    for key in (0.25, 0.5, 1 / 4):
        workspace.get("square", key, lambda key=key: computed.append(key) or key**2)  # type: ignore[misc]
    assert computed == [0.25, 0.5]


def test_the_oldest_value_goes() -> None:
    workspace = Workspace()
    for key in range(3):
        workspace.get("number", key, object, limit=2)
    latest = workspace.get("number", 2, object, limit=2)
    assert workspace.get("number", 2, object, limit=2) is latest
    first = workspace.get("number", 0, lambda: "computed again", limit=2)
    assert first == "computed again"


def test_a_changed_segment_is_computed_anew(segment: Segment) -> None:
    before = channels.measured(segment)
    faster = dataclasses.replace(segment, gyro=2 * segment.gyro)
    assert not np.allclose(channels.measured(faster), before)
    np.testing.assert_array_equal(channels.measured(segment), before)


def test_segments_have_one_digest_where_all_rows_are_equal(segment: Segment) -> None:
    assert dataclasses.replace(segment, gyro=segment.gyro.copy()).digest == segment.digest
    arrays = ("position", "velocity", "attitude", "gyro", "specific_force", "rotor_speed")
    changed = [dataclasses.replace(segment, **{name: 1.001 * getattr(segment, name)}) for name in arrays]
    changed += [dataclasses.replace(segment, **{name: None}) for name in ("gyro", "specific_force")]
    changed += [dataclasses.replace(segment, rotor_share=0.5), dataclasses.replace(segment, rate=2 * segment.rate)]
    assert len({segment.digest, *(one.digest for one in changed)}) == 1 + len(changed)


def test_vehicles_of_one_content_have_one_key(arpl_250g: Vehicle) -> None:
    def loaded(mass: float) -> Vehicle:
        use = EffectUse("slung_load", {"mass": mass, "length": 0.5})
        return msgspec.structs.replace(arpl_250g, effects=(use,))

    assert key_of(loaded(0.02)) == key_of(loaded(0.02)) != key_of(loaded(0.03))


def test_what_was_computed_ends_with_the_segment(segment: Segment, arpl_250g: Vehicle) -> None:
    own = dataclasses.replace(segment)
    use = EffectUse("rotor_delay", {"delay": 0.01})
    Predictor(arpl_250g, [use], CATALOGUE, speed_measured=True).predict(own)
    measured = weakref.ref(channels.measured(own))
    assert measured() is not None
    del own
    gc.collect()
    assert measured() is None


def test_a_start_is_judged_by_the_thresholds_that_are_given(segment: Segment, arpl_250g: Vehicle) -> None:
    def start(min_excess: float) -> np.ndarray:
        limits = msgspec.structs.replace(DEFAULT.prediction, free_start_excess=min_excess)
        use = EffectUse("slung_load", {"mass": 0.0, "length": 0.5})
        model = Predictor(arpl_250g, [use], CATALOGUE, speed_measured=True, thresholds=limits)
        return model.states(segment)[0, 13:]

    hover = [0, 0, -1, 0, 0, 0]
    assert not np.allclose(start(0.0), hover)
    np.testing.assert_array_equal(start(np.inf), hover)
