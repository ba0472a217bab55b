"""[controller] of a vehicle file: derived defaults, refusals, and the way to the file and back."""

import msgspec
import numpy as np
import pytest

from dynamics.controller_defaults import lookaheads
from dynamics.controller_settings import GRID, ControllerSettings, intervals_of
from dynamics.errors import RequestError
from dynamics.rate_loop import rate_loop
from dynamics.vehicle import EffectUse, Vehicle
from dynamics.vehicle_file import parse_vehicle, read_vehicle, vehicle_toml, with_settings
from vehicles import FOLDER


def test_defaults_are_not_written_and_settings_come_back(arpl_250g: Vehicle) -> None:
    assert "controller" not in vehicle_toml(arpl_250g)
    changed = with_settings(arpl_250g, ["controller.horizon=0.8", "controller.position_weight=[60, 60, 90]"])
    assert changed.controller.horizon == 0.8
    assert changed.controller.position_weight == (60.0, 60.0, 90.0)
    assert parse_vehicle(vehicle_toml(changed)) == changed


def test_a_later_setting_replaces_one_of_the_file(arpl_250g: Vehicle) -> None:
    first = with_settings(arpl_250g, ["controller.delay=0.01", "controller.nodes=25"])
    second = with_settings(first, ["controller.delay=0.02"])
    assert (second.controller.delay, second.controller.nodes) == (0.02, 25)


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ("controller.horizn=1", "did you mean 'horizon'"),
        ("horizon=1", "write controller.KEY=VALUE"),
        ("controller.horizon", "write controller.KEY=VALUE"),
        ("controller.horizon=long", "is no number"),
        ("controller.horizon=inf", "finite"),
        ("controller.rate_lookahead=nan", "finite"),
        ("controller.nodes=1", "give 2 to 100"),
        ("controller.nodes=101", "give 2 to 100"),
        ("controller.nodes=20.5", "nodes holds a number; wanted is a whole number"),
        ("controller.velocity_weight=[1, -1, 1]", "velocity_weight = -1: give 0"),
        ("controller.position_weight=[0, 0, 0]", "zero in all axes"),
        ("controller.input_weight=0", "input_weight = 0"),
        ("controller.delay=0.5", "delay = 0.5: give 0 to 0.1"),
        ("controller.yaw_lookahead=1.5", "beyond the horizon of 1 s"),
        ("controller.rate=19", "rate = 19: give 20 to 500"),
    ],
)
def test_what_cannot_be_flown_is_refused_with_the_bound(arpl_250g: Vehicle, setting: str, message: str) -> None:
    with pytest.raises(RequestError) as refusal:
        with_settings(arpl_250g, [setting])
    assert message in str(refusal.value)


def test_a_period_longer_than_a_node_is_refused(arpl_250g: Vehicle) -> None:
    with pytest.raises(RequestError, match="period of 50 ms is longer than a node of 25 ms"):
        with_settings(arpl_250g, ["controller.rate=20", "controller.nodes=40"])


def test_a_horizon_shorter_than_the_rate_loop_is_refused(arpl_250g: Vehicle) -> None:
    with pytest.raises(RequestError, match=r"too short for arpl_250g.*Give at least 0.12 s"):
        with_settings(arpl_250g, ["controller.horizon=0.1", "controller.nodes=5"])


def test_a_file_with_an_unknown_key_is_refused(arpl_250g: Vehicle) -> None:
    with pytest.raises(RequestError, match=r"unknown key 'weight' in \[controller\]"):
        parse_vehicle(vehicle_toml(arpl_250g) + "\n[controller]\nweight = 1\n")


def test_lookaheads_are_the_delays_of_the_rate_loop() -> None:
    """px4_sih's model has its motors' lag, so that only the rest of the loop is looked ahead."""
    for name, lag in (("arpl_250g", 0.0), ("crazyflie", 0.0), ("px4_sih", 0.05)):
        vehicle = read_vehicle(FOLDER / f"{name}.toml")
        loop, lookahead = rate_loop(vehicle), lookaheads(vehicle)
        assert lookahead.rate == pytest.approx(loop.tilt_time - lag)
        assert lookahead.yaw == pytest.approx(loop.yaw_time - lag)
        assert 0.05 < lookahead.rate < 0.08


def test_slower_motors_are_looked_further_ahead_unless_the_file_has_lookaheads(arpl_250g: Vehicle) -> None:
    slow = arpl_250g.with_effects(EffectUse("motor_lag", {"time_constant": 0.06}))
    assert rate_loop(slow).tilt_time > 2 * rate_loop(arpl_250g).tilt_time
    assert lookaheads(slow).rate > lookaheads(arpl_250g).rate
    fixed = msgspec.structs.replace(slow, controller=ControllerSettings(rate_lookahead=0.04, yaw_lookahead=0.1))
    assert (lookaheads(fixed).rate, lookaheads(fixed).yaw) == (0.04, 0.1)


def test_a_vehicle_that_cannot_yaw_is_looked_ahead_no_further_than_the_horizon(arpl_250g: Vehicle) -> None:
    rotors = msgspec.structs.replace(arpl_250g.rotors, torque_constant=0.0)
    assert lookaheads(msgspec.structs.replace(arpl_250g, rotors=rotors)).yaw == ControllerSettings().horizon


@pytest.mark.parametrize(("nodes", "horizon", "growth"), [(10, 1.0, 1.2), (10, 0.7, 1.15), (5, 0.305, 1.6)])
def test_intervals_that_grow_lie_on_the_grid_and_fill_the_horizon(nodes: int, horizon: float, growth: float) -> None:
    intervals = np.array(intervals_of(horizon, nodes, growth))
    assert intervals.sum() == pytest.approx(horizon, abs=1e-12)
    np.testing.assert_allclose(intervals[:-1] / GRID, np.round(intervals[:-1] / GRID), atol=1e-9)
    ends = horizon * (growth ** np.arange(1, nodes + 1) - 1) / (growth**nodes - 1)
    np.testing.assert_allclose(np.cumsum(intervals), ends, atol=GRID / 2 + 1e-9)


def test_a_growth_of_one_gives_equal_intervals_to_the_bit() -> None:
    assert intervals_of(0.7, 10, 1.0) == (0.7 / 10,) * 10


def test_a_first_interval_shorter_than_a_period_is_refused(arpl_250g: Vehicle) -> None:
    with pytest.raises(RequestError, match="longer than a node of 20 ms"):
        with_settings(arpl_250g, ["controller.rate=40", "controller.growth=1.3", "controller.nodes=10"])
    with pytest.raises(RequestError, match=r"growth = 2: the first of 20 intervals in 1 s would be shorter than 10 ms"):
        with_settings(arpl_250g, ["controller.growth=2"])
