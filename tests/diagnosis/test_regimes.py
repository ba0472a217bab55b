"""Where a model fails is shown where it was flown, and its residuals' spectrum over that of the sensors' noise."""

from types import SimpleNamespace

import msgspec
import numpy as np
import pytest

from diagnosis.comparison import compare_dataset
from diagnosis.data.dataset import make_dataset
from diagnosis.regimes import causes_first, plane_cells, regime_maps, regime_planes, worst_cells
from diagnosis.spectrum import residual_spectrum
from diagnosis.thresholds import DEFAULT
from dynamics.effects import CATALOGUE
from dynamics.state import VELOCITY

SOME = {name: CATALOGUE[name] for name in ("rotor_drag", "imu_bias", "gyro_bias", "time_delay")}
QUANTITIES = {
    "speed m/s",
    "thrust over weight",
    "body rate rad/s",
    "roll rate rad/s",
    "pitch rate rad/s",
    "yaw rate rad/s",
    "height m",
    "east m",
    "north m",
    "heading of motion rad",
    "time s",
}


@pytest.fixture(scope="module")
def segments(plain_flights, arpl_250g):
    return make_dataset(plain_flights, arpl_250g).everything


def failing_fast(segment, above=1.5):
    """Residuals at their floor of 1, five times as large in the accelerometer above a speed, m/s."""
    rows = segment.decimated
    fast = np.linalg.norm(segment.smooth[rows, VELOCITY], axis=1) > above
    rows_of_one = np.ones((len(fast), 12))
    rows_of_one[fast, 0:3] *= 5
    return rows_of_one


def test_every_regime_that_the_flights_have_is_mapped_and_the_planted_one_stands_out(segments, arpl_250g):
    rows = [failing_fast(s) for s in segments]
    maps = {m.name: m for m in regime_maps(segments, rows, np.ones(12), arpl_250g)}
    assert set(maps) >= QUANTITIES
    speed = maps["speed m/s"]
    above = speed.edges[:-1] > 1.5
    assert np.nanmin(speed.over_floor[0, above]) == pytest.approx(5.0)
    assert np.nanmax(speed.over_floor[0, speed.edges[1:] < 1.5]) == pytest.approx(1.0)
    np.testing.assert_allclose(speed.over_floor[2][np.isfinite(speed.over_floor[2])], 1.0)


def test_planes_leave_what_was_not_flown_unmarked(segments, arpl_250g):
    rows = [failing_fast(s) for s in segments]
    planes = {(p.across, p.up): p for p in regime_planes(segments, rows, np.ones(12), arpl_250g)}
    plane = planes["speed m/s", "thrust over weight"]
    assert plane.over_floor.shape == (4, DEFAULT.regimes.bins, DEFAULT.regimes.bins)
    assert 0 < np.isnan(plane.over_floor[0]).sum() < DEFAULT.regimes.bins * DEFAULT.regimes.bins
    last = plane.over_floor[0][:, -1]  # the fastest column, some of whose thrusts were flown
    assert np.nanmax(last) == pytest.approx(5.0)
    cells = plane_cells(plane).over_floor["imu"]
    assert sum(cell is None for row in cells for cell in row) == np.isnan(plane.over_floor[0]).sum()


def white(rate, floor):
    """White noise of a level (12,) in rows at a rate, Hz."""

    def density(frequency):
        return np.outer(floor**2, np.ones(len(frequency))) / rate

    return SimpleNamespace(rate=rate, floor=floor, density=density, segments=[SimpleNamespace(filters=DEFAULT.filters)])


def test_a_line_stands_out_of_the_noise_models_spectrum():
    random = np.random.default_rng(0)
    noise_rows = [random.standard_normal((2000, 12)) for _ in range(2)]
    noise = white(25.0, (np.arange(12) < 9).astype(float))
    swung = noise_rows[0].copy()
    swung[:, 4] += np.sin(2 * np.pi * 3.0 * np.arange(2000) / 25.0)
    spectrum = residual_spectrum([swung], noise)
    ratio = spectrum.power / spectrum.noise
    assert np.nanmedian(ratio) == pytest.approx(1.0, abs=0.15)
    assert spectrum.frequency[np.argmax(ratio[4])] == pytest.approx(3.0, abs=0.2)
    assert ratio[4].max() > 10 > np.delete(ratio[:9], 4, axis=0).max()
    assert np.isnan(spectrum.power[9:]).all()


def test_the_comparison_as_json_holds_maps_planes_and_spectrum(plain_flights, arpl_250g):
    details = compare_dataset(make_dataset(plain_flights, arpl_250g), arpl_250g, SOME)
    written = msgspec.json.decode(msgspec.json.encode(details.comparison))
    assert {m["name"] for m in written["maps"]} >= QUANTITIES
    assert [p["across"] for p in written["planes"]] == ["speed m/s", "roll rate rad/s", "east m"]
    assert any(None in row for plane in written["planes"] for row in plane["over_floor"]["imu"])
    assert set(written["spectrum"]["power"]) == set(written["spectrum"]["noise"])
    assert len(written["spectrum"]["frequency"]) == len(written["spectrum"]["power"]["imu x"])


def test_a_cause_is_named_before_what_merely_moves_with_it():
    """The error grows with speed; thrust follows speed half of the time, height not at all."""
    random = np.random.default_rng(3)
    speed = random.integers(0, 8, 20000)
    thrust = np.where(random.random(len(speed)) < 0.6, speed, random.integers(0, 8, len(speed)))
    height = random.integers(0, 8, len(speed))
    squares = (1.0 + speed**2) * random.chisquare(3, len(speed)) / 3
    assert causes_first(squares, np.array([thrust, height, speed]), 8)[2] == 0
    # what thrust alone would show is left of nothing once speed is known
    both = causes_first(squares + 0.2 * height * random.chisquare(3, len(speed)), np.array([thrust, height, speed]), 8)
    assert both.tolist() == [2, 1, 0]


def test_the_failures_of_a_diagnosis_begin_with_their_cause(segments, arpl_250g):
    rows = [failing_fast(s, above=2.2) for s in segments]
    first, *_ = worst_cells(regime_maps(segments, rows, np.ones(12), arpl_250g))
    assert (first.regime, first.channel) == ("speed m/s", "imu")
