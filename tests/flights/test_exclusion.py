"""What is no free flight is left out: ground, impacts and crashes, planted and real; and nothing else is."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from dynamics import quaternion
from dynamics.arrays import Floats
from flights import Flight
from flights.exclusion import Exclusion, excluded_rows, find_exclusions, free_flight
from flights.log import Provenance
from tests.support.simulated_flight import flown, table

RATE = 100.0
HOVER = 1200.0  # rad/s


def hovering(seconds: float = 30.0) -> dict[str, Floats]:
    """Columns of a vehicle that hovers at 1 m with a little noise."""
    count = round(seconds * RATE)
    random = np.random.default_rng(3)
    columns = {f"rotor_speed_{rotor}": HOVER + random.normal(0, 5, count) for rotor in range(4)}
    for axis, usual in zip("xyz", (0.0, 0.0, 9.81), strict=True):
        columns[f"specific_force_{axis}"] = usual + random.normal(0, 0.2, count)
        columns[f"rate_{axis}"] = random.normal(0, 0.1, count)
        columns[f"velocity_{axis}"] = 0.3 + random.normal(0, 0.02, count)
        columns[f"position_{axis}"] = np.full(count, 1.0)
    columns |= {f"attitude_{part}": np.full(count, float(part == "w")) for part in "wxyz"}
    return columns


def flight(columns: dict[str, Floats]) -> Flight:
    count = len(columns["rotor_speed_0"])
    return Flight(np.arange(count) / RATE, columns, Provenance("planted", "", "", ""))


def rows(start: float, stop: float) -> slice:
    return slice(round(start * RATE), round(stop * RATE))


def stand(columns: dict[str, Floats], start: float, stop: float, *, speed: float = 0.0) -> None:
    """On the ground with rotors at a speed."""
    for rotor in range(4):
        columns[f"rotor_speed_{rotor}"][rows(start, stop)] = speed
    for axis, usual in zip("xyz", (0.0, 0.0, 9.81), strict=True):
        columns[f"specific_force_{axis}"][rows(start, stop)] = usual
        columns[f"rate_{axis}"][rows(start, stop)] = 0.0
        columns[f"velocity_{axis}"][rows(start, stop)] = 0.0
    columns["position_z"][rows(start, stop)] = 0.0


def only(exclusions: tuple[Exclusion, ...], reason: str) -> Exclusion:
    (item,) = [item for item in exclusions if item.reason == reason]
    return item


def test_a_flight_without_anything_wrong_is_kept_whole() -> None:
    assert find_exclusions(flight(hovering())) == ()
    simulated = table(flown().log)
    assert find_exclusions(simulated) == ()


def test_standing_before_and_after_is_ground_with_spool_up_around_it() -> None:
    columns = hovering()
    stand(columns, 0.0, 5.0)
    stand(columns, 25.0, 30.0)
    exclusions = find_exclusions(flight(columns))
    assert [item.reason for item in exclusions] == ["ground", "ground"]
    assert exclusions[0].stop == pytest.approx(5.3, abs=0.05)
    assert exclusions[1].start == pytest.approx(24.7, abs=0.05)


def test_standing_with_turning_rotors_is_ground_too() -> None:
    columns = hovering()
    stand(columns, 0.0, 5.0)
    stand(columns, 5.0, 7.0, speed=0.9 * HOVER)
    assert only(find_exclusions(flight(columns)), "ground").stop == pytest.approx(7.3, abs=0.05)


def test_free_fall_with_idle_rotors_is_flight() -> None:
    columns = hovering()
    for rotor in range(4):
        columns[f"rotor_speed_{rotor}"][rows(10, 10.6)] = 100.0
    columns["specific_force_z"][rows(10, 10.6)] = 0.1
    assert find_exclusions(flight(columns)) == ()


def test_what_the_land_detector_reports_is_ground() -> None:
    columns = hovering()
    columns["landed"] = np.zeros(3000)
    columns["landed"][rows(20, 30)] = 1.0
    assert only(find_exclusions(flight(columns)), "ground").start == pytest.approx(19.7, abs=0.05)


def test_a_bump_is_an_impact_and_only_its_surroundings_are_lost() -> None:
    columns = hovering()
    hit(columns, 15.0, 60.0)
    item = only(find_exclusions(flight(columns)), "impact")
    assert (item.start, item.stop) == (pytest.approx(14.75, abs=0.03), pytest.approx(15.26, abs=0.03))


def hit(columns: dict[str, Floats], at: float, force: float) -> None:
    """A blow of 0.02 s, which the velocity keeps, by a position controller for half a second."""
    columns["specific_force_x"][rows(at, at + 0.02)] = force
    columns["velocity_x"][rows(at + 0.02, at + 0.5)] += 0.02 * force


@pytest.mark.parametrize(
    "spikes",
    [pytest.param((60.0, 60.0), id="one way"), pytest.param((70.0, -70.0, 70.0, -70.0), id="to and fro")],
)
def test_an_accelerometer_that_clips_while_the_motion_is_smooth_is_no_impact(spikes: tuple[float, ...]) -> None:
    columns = hovering()
    columns["specific_force_x"][rows(15, 15 + len(spikes) / RATE)] = spikes
    (item,) = find_exclusions(flight(columns))
    assert item.reason == "clipping"
    assert item.start < 15.0 < 15 + len(spikes) / RATE < item.stop < 15.3


@pytest.mark.parametrize("without", ["velocity", "rate", "attitude"])
def test_a_jump_is_an_impact_where_the_motion_is_not_known(without: str) -> None:
    columns = hovering()
    columns["specific_force_x"][rows(15, 15.02)] = 60.0
    remaining = {name: values for name, values in columns.items() if not name.startswith(without)}
    assert [item.reason for item in find_exclusions(flight(remaining))] == ["impact"]


def test_a_blow_that_only_turns_the_vehicle_is_an_impact() -> None:
    columns = hovering()
    columns["specific_force_x"][rows(15, 15.02)] = (60.0, -60.0)
    columns["rate_z"][rows(15.01, 15.05)] = 8.0
    assert [item.reason for item in find_exclusions(flight(columns))] == ["impact"]


def crash(columns: dict[str, Floats], at: float, *, until: float) -> None:
    """Hits a wall, falls, lies with rotors off until it is started again."""
    hit(columns, at, 79.0)
    stand(columns, at + 0.4, until)


def test_a_crash_is_excluded_from_the_impact_until_it_flies_again() -> None:
    columns = hovering()
    crash(columns, 12.0, until=17.0)
    item = only(find_exclusions(flight(columns)), "crash")
    assert item.start == pytest.approx(11.75, abs=0.03)
    assert 16.9 < item.stop < 18.0
    segments = free_flight(flight(columns))
    assert [round(float(segment.time[0])) for segment in segments] == [0, 17]


def test_a_crash_shows_in_gyro_accelerometer_and_commands_alone() -> None:
    """As in log16 of the Crazyflie at 1 kHz: 79 m/s^2 at 39.3 s, motors at 0 until 44 s, then it flies on."""
    time = np.arange(32.0, 49.0, 1e-3)
    random = np.random.default_rng(7)
    columns = {
        f"specific_force_{axis}": usual + random.normal(0, 0.6, len(time))
        for axis, usual in zip("xyz", (0.0, 0.0, 9.81), strict=True)
    }
    columns |= {f"rate_{axis}": random.normal(0, 0.3, len(time)) for axis in "xyz"}
    columns |= {f"rotor_command_{rotor}": 0.6 + random.normal(0, 0.05, len(time)) for rotor in range(4)}
    impact, lying = (time >= 39.3) & (time < 39.31), (time >= 39.35) & (time < 44.0)
    columns["specific_force_y"][impact] = -79.0
    for name in columns:
        columns[name][lying] = 0.0
    columns["specific_force_x"][lying] = 9.81  # on its side
    exclusions = find_exclusions(Flight(time, columns, Provenance("planted", "", "", "")))
    item = only(exclusions, "crash")
    assert item.start == pytest.approx(39.05, abs=0.02)
    assert 43.9 < item.stop < 45.0
    assert {other.reason for other in exclusions} <= {"crash", "ground"}  # stands on the ground when it is over


def test_idle_rotors_on_the_ground_take_precedence_over_a_late_land_detector() -> None:
    columns = hovering()
    stand(columns, 20.0, 30.0, speed=0.2 * HOVER)
    columns["landed"] = (np.arange(3000) >= 2800).astype(float)
    item = only(find_exclusions(flight(columns)), "ground")
    assert item.start == pytest.approx(19.7, abs=0.1)
    assert item.stop == pytest.approx(29.99, abs=0.02)


def test_a_crash_that_ends_the_flight_is_excluded_to_the_end() -> None:
    columns = hovering()
    crash(columns, 20.0, until=30.0)
    assert only(find_exclusions(flight(columns)), "crash").stop == pytest.approx(29.99, abs=0.02)


def test_a_crash_without_an_accelerometer_shows_by_lying_on_the_side() -> None:
    columns = {name: values for name, values in hovering().items() if not name.startswith("specific_force")}
    tilt = np.concatenate([np.zeros(2000), np.linspace(0, 2.5, 50), np.full(950, 2.5)])
    attitude = quaternion.from_euler(tilt, 0 * tilt, 0 * tilt)
    columns |= {f"attitude_{part}": attitude[:, k] for k, part in enumerate("wxyz")}
    for axis in "xyz":
        columns[f"velocity_{axis}"][rows(20.5, 30)] = 0.0
        columns[f"rate_{axis}"][rows(20.5, 30)] = 0.0
    item = only(find_exclusions(flight(columns)), "crash")
    assert 19.5 < item.start < 20.2
    assert item.stop == pytest.approx(29.99, abs=0.02)


def test_a_landing_with_a_bump_is_ground_and_no_crash() -> None:
    columns = hovering()
    columns["position_z"][rows(20, 25)] = np.linspace(1.0, 0.0, 500)
    columns["specific_force_z"][rows(24.98, 25.0)] = 45.0
    stand(columns, 25.0, 30.0)
    assert {item.reason for item in find_exclusions(flight(columns))} == {"ground"}


def test_excluded_rows_are_those_between_start_and_stop() -> None:
    item = Exclusion("impact", 1.0, 2.0, "")
    chosen = excluded_rows(flight(hovering(5.0)), [item])
    assert np.flatnonzero(chosen).tolist() == list(range(100, 201))


def test_a_real_flight_of_a_coaxial_vehicle_is_what_lies_between_take_off_and_landing() -> None:
    real = Flight.read(Path("tests/data/acsl_x8copter/log_20240613_115633_cut.log.gz"))
    segments = free_flight(real)
    assert segments
    for segment in segments:
        assert segment["position"][:, 2].max() > 0.1
    assert all(item.reason == "ground" for item in find_exclusions(real))


PX4 = Path("tests/data/px4_sih_flights")


def lie(columns: dict[str, Floats], start: float, stop: float, *, tilt: float, speed: float) -> None:
    """On the ground at a tilt in rad with rotors at a speed; gravity's reaction is all that the accelerometer reads."""
    attitude = quaternion.from_euler(*np.array([[tilt], [0.0], [0.0]]))[0]
    reaction = quaternion.rotate_inverse(attitude, np.array([0.0, 0.0, 9.81]))
    random = np.random.default_rng(11)
    for k, part in enumerate("wxyz"):
        columns[f"attitude_{part}"][rows(start, stop)] = attitude[k]
    for axis, value in zip("xyz", reaction, strict=True):
        columns[f"specific_force_{axis}"][rows(start, stop)] = value + random.normal(
            0, 0.2, rows(start, stop).stop - rows(start, stop).start
        )
    for rotor in range(4):
        columns[f"rotor_speed_{rotor}"][rows(start, stop)] = speed


def test_lying_at_a_tilt_with_turning_rotors_is_no_free_flight() -> None:
    """Drifting by 0.5 m/s in its estimate, and for the land detector still in flight."""
    columns = hovering()
    columns["landed"] = np.zeros(3000)
    lie(columns, 20.0, 30.0, tilt=1.06, speed=1.2 * HOVER)
    assert sum(part.duration for part in free_flight(flight(columns))) == pytest.approx(20.0, abs=0.7)


def test_standing_with_rotors_below_the_weight_is_ground_although_the_detector_reports_flight() -> None:
    columns = hovering()
    columns["landed"] = np.zeros(3000)
    lie(columns, 0.0, 5.0, tilt=0.0, speed=0.75 * HOVER)
    assert only(find_exclusions(flight(columns)), "ground").stop == pytest.approx(5.3, abs=0.2)


@pytest.mark.parametrize(("degrees", "speed"), [(20.0, 0.3), (34.0, 0.3), (34.0, 0.0), (52.0, 0.0)])
def test_hovering_in_strong_wind_is_flight(degrees: float, speed: float) -> None:
    """Tilted against the air, drifting or still, the rotors carry the weight."""
    columns, tilt = hovering(), np.deg2rad(degrees)
    lie(columns, 10.0, 20.0, tilt=tilt, speed=HOVER * np.sqrt(np.cos(tilt)))
    for axis in "xyz":
        columns[f"velocity_{axis}"][rows(10.0, 20.0)] = speed
        columns[f"rate_{axis}"][rows(10.0, 20.0)] = 0.02
    assert find_exclusions(flight(columns)) == ()


def test_a_dive_with_idle_rotors_is_flight() -> None:
    """At 6 m/s the air carries 0.7 of the weight."""
    columns = hovering()
    for rotor in range(4):
        columns[f"rotor_speed_{rotor}"][rows(10, 11)] = 0.2 * HOVER
    columns["specific_force_z"][rows(10, 11)] = 7.0
    columns["velocity_z"][rows(10, 11)] = -6.0
    columns["landed"] = np.zeros(3000)
    assert find_exclusions(flight(columns)) == ()


def test_a_steady_descent_is_flight() -> None:
    columns = hovering()
    for rotor in range(4):
        columns[f"rotor_speed_{rotor}"][rows(10, 13)] = 0.75 * HOVER
    columns["velocity_z"][rows(10, 13)] = -1.0
    assert find_exclusions(flight(columns)) == ()


def test_a_real_vehicle_that_lies_on_its_side_with_motors_on_never_flew() -> None:
    real = Flight.read(PX4 / "refused_lying_61deg.ulg.gz")
    assert free_flight(real) == ()
    assert {item.reason for item in find_exclusions(real)} == {"ground"}


def test_a_real_vehicle_that_tips_over_on_landing_flew_until_it_touched_the_ground() -> None:
    """10.0 s in the air; then motors on for 24 s, the estimate drifting and PX4's land detector reporting flight."""
    (flown_part,) = free_flight(Flight.read(PX4 / "tipped_140deg.ulg.gz"))
    assert flown_part.duration == pytest.approx(10.2, abs=0.3)


def test_real_flights_are_whole_between_lift_off_and_touch_down() -> None:
    (part,) = free_flight(Flight.read(PX4 / "drag2_4_lemniscate.ulg.gz"))
    assert part.duration == pytest.approx(49.3, abs=0.5)
