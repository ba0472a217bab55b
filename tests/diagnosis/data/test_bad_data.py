"""Data are checked before any model is judged: what cannot answer is refused, with what to do."""

import msgspec
import numpy as np
import pytest

from diagnosis.data.data_checks import require_answerable
from diagnosis.data.dataset import make_dataset, read_dataset
from dynamics.errors import DataError, RequestError
from flights.log import Origin
from tests.diagnosis.conftest import with_columns


def judge(flights, vehicle):
    require_answerable(make_dataset(flights, vehicle).everything, vehicle)


def test_good_flights_pass(plain_flights, arpl_250g):
    judge(plain_flights, arpl_250g)


def test_too_little_flight_is_refused(plain_flights, arpl_250g):
    with pytest.raises(DataError, match="too few to hold a part out"):
        judge([flight.rows(200, 700) for flight in plain_flights[:2]], arpl_250g)


def test_hover_is_refused_as_too_gentle(plain_flights, arpl_250g):
    def still(flight):
        random = np.random.default_rng(0)
        hover = {f"rotor_speed_{i}": np.full(len(flight), arpl_250g.hover_speed) for i in range(4)}
        rate = {f"rate_{a}": 0.01 * random.standard_normal(len(flight)) for a in "xyz"}
        level = {f"attitude_{a}": np.full(len(flight), float(a == "w")) for a in "wxyz"}
        rest = {f"velocity_{a}": 0.01 * random.standard_normal(len(flight)) for a in "xyz"}
        force = {f"specific_force_{a}": np.full(len(flight), 9.81 * (a == "z")) for a in "xyz"}
        return with_columns(flight, {**hover, **rate, **level, **rest, **force})

    with pytest.raises(DataError, match=r"too gentle.*straight accelerations"):
        judge([still(flight) for flight in plain_flights], arpl_250g)


def test_a_vehicle_file_of_twice_the_mass_is_refused(plain_flights, arpl_250g):
    body = msgspec.structs.replace(arpl_250g.body, mass=2 * arpl_250g.body.mass)
    rotors = msgspec.structs.replace(arpl_250g.rotors, speed_max=2500.0)
    with pytest.raises(DataError, match=r"0\.\d+ times the thrust.*Check mass"):
        judge(plain_flights, msgspec.structs.replace(arpl_250g, body=body, rotors=rotors))


def test_rotor_speeds_in_rpm_are_recognised(changed, arpl_250g):
    columns = {f"rotor_speed_{i}": (lambda old: old * 30 / np.pi) for i in range(4)}
    with pytest.raises(DataError, match="in rpm"):
        judge(changed(**columns), arpl_250g)


def test_another_order_of_rotors_is_named(plain_flights, arpl_250g):
    order = [2, 0, 3, 1]  # the file's rotor i is the log's column order[i]
    shuffled = [
        with_columns(f, {f"rotor_speed_{column}": f[f"rotor_speed_{i}"] for i, column in enumerate(order)})
        for f in plain_flights
    ]
    with pytest.raises(DataError, match=r"columns \[2, 0, 3, 1\]"):
        judge(shuffled, arpl_250g)


@pytest.mark.parametrize("shift", [0, 1, 2])
def test_a_wrong_order_of_many_rotors_is_noticed_without_trying_all(plain_flights, arpl_250g, shift):
    """Eight rotors, two on each arm."""
    rotors = arpl_250g.rotors
    twice = msgspec.structs.replace(
        rotors, position=rotors.position * 2, spin=rotors.spin * 2, thrust_constant=rotors.thrust_constant / 2
    )
    vehicle = msgspec.structs.replace(arpl_250g, rotors=twice)
    pairs = [
        with_columns(f, {f"rotor_speed_{i}": f[f"rotor_speed_{(i + shift) % 4}"] for i in range(8)})
        for f in plain_flights
    ]
    if shift == 0:
        judge(pairs, vehicle)
        return
    with pytest.raises(DataError, match="too many to try"):
        judge(pairs, vehicle)


def test_a_dead_speed_sensor_is_no_dead_rotor(changed, arpl_250g):
    bare = {f"rotor_command_{i}": None for i in range(4)}
    with pytest.raises(DataError, match=r"rotor 1 \(back left; .*\) reads 0.00 times.*rotor_speed_fault"):
        judge([with_columns(f, bare) for f in changed(rotor_speed_1=lambda old: 0 * old)], arpl_250g)


def test_a_log_without_motors_is_refused(plain_flights, arpl_250g):
    bare = {f"{kind}_{i}": None for kind in ("rotor_speed", "rotor_command") for i in range(4)}
    with pytest.raises(DataError, match="Wanted rotor speeds, motor commands"):
        make_dataset([with_columns(flight, bare) for flight in plain_flights], arpl_250g)


def test_motors_at_10_hz_are_refused_with_the_profile_to_set(plain_flights, arpl_250g):
    def slow(flight):
        bare = with_columns(flight, {f"rotor_speed_{i}": None for i in range(4)})
        origins = {**bare.origins, "rotor_command": Origin("actuator_outputs", 10.0, 100)}
        return type(flight)(bare.time, bare.columns, bare.provenance, origins)

    with pytest.raises(DataError, match=r"at 10 Hz.*SDLOG_PROFILE"):
        make_dataset([slow(flight) for flight in plain_flights], arpl_250g)


def test_a_pose_that_was_logged_slowly_is_no_pose(plain_flights, arpl_250g):
    """PX4's default profile: gyro and motors may be fast, attitude and position never are."""

    def seldom(flight):
        slow = {n: Origin("vehicle_local_position", 10.0, 100) for n in ("position", "velocity", "attitude")}
        return type(flight)(flight.time, flight.columns, flight.provenance, {**flight.origins, **slow})

    dataset = make_dataset([seldom(f) for f in plain_flights], arpl_250g)
    assert dataset.fitted[0].lacks == {"velocity", "attitude"}
    assert any("too slow to be used: attitude at 10 Hz, velocity at 10 Hz" in note for note in dataset.notes)
    bare = {f"{kind}_{a}": None for kind in ("specific_force", "rate") for a in "xyz"}
    with pytest.raises(DataError, match="it lacks gyro, accelerometer, attitude at 10 Hz, velocity at 10 Hz"):
        make_dataset([with_columns(seldom(f), bare) for f in plain_flights], arpl_250g)


def test_measured_and_commanded_rotors_are_not_mixed(plain_flights, arpl_250g):
    commanded = with_columns(plain_flights[1], {f"rotor_speed_{i}": None for i in range(4)})
    with pytest.raises(DataError, match=r"measured: flight_0.csv; command: flight_1.csv"):
        make_dataset([plain_flights[0], commanded], arpl_250g)


def test_what_a_log_lacks_is_noted(plain_flights, arpl_250g):
    bare = {f"{kind}_{a}": None for kind in ("specific_force", "rate") for a in "xyz"}
    notes = make_dataset([with_columns(flight, bare) for flight in plain_flights], arpl_250g).notes
    assert any("no accelerometer" in note for note in notes)
    assert any("no gyro" in note for note in notes)


def test_copies_of_a_flight_are_no_new_flights(plain_flights, arpl_250g):
    with pytest.raises(DataError, match="one and the same"):
        make_dataset([plain_flights[0]] * 3, arpl_250g)
    dataset = make_dataset([*plain_flights, plain_flights[0]], arpl_250g)
    assert any("copies" in note for note in dataset.notes)


def test_of_one_flight_the_last_fifth_is_held_out(plain_flights, arpl_250g):
    first, second = plain_flights[4:6]
    time = np.concatenate([first.time, second.time + first.time[-1] + first.period])
    columns = {name: np.concatenate([first.columns[name], second.columns[name]]) for name in first.columns}
    dataset = make_dataset([type(first)(time, columns, first.provenance, first.origins)], arpl_250g)
    total = sum(s.duration for s in dataset.everything)
    assert sum(s.duration for s in dataset.held_out) == pytest.approx(0.2 * total, rel=0.05)
    assert min(s.start for s in dataset.held_out) > max(s.start for s in dataset.fitted)
    assert any("one flight only" in note for note in dataset.notes)


@pytest.mark.parametrize("rows", [1, 2, 100])
def test_a_log_of_a_second_and_less_holds_no_flight(plain_flights, arpl_250g, tmp_path, rows):
    short = [flight.rows(0, rows).to_csv(tmp_path / f"short_{i}.csv") for i, flight in enumerate(plain_flights[:2])]
    with pytest.raises(DataError, match=r"short_0\.csv.*(uninterrupted flight|row)"):
        read_dataset(short, arpl_250g)
    long = [flight.to_csv(tmp_path / f"long_{i}.csv") for i, flight in enumerate(plain_flights)]
    dataset = read_dataset([*short, *long], arpl_250g)
    assert any("left out" in note and "short_1.csv" in note for note in dataset.notes)
    assert set(dataset.hashes) | set(dataset.held_hashes) == {str(path) for path in long}


def test_a_quantity_without_numbers_is_named(changed, arpl_250g, tmp_path):
    infinite = changed(specific_force_z=lambda z: np.full_like(z, np.inf))
    logs = [flight.to_csv(tmp_path / f"flight_{i}.csv") for i, flight in enumerate(infinite)]
    with pytest.raises(DataError, match=r"specific_force holds no number in 100% of the rows"):
        read_dataset(logs, arpl_250g)


def test_a_pattern_selects_the_flights_that_are_held_out(plain_flights, arpl_250g, tmp_path):
    paths = [flight.to_csv(tmp_path / f"flight_{i}.csv") for i, flight in enumerate(plain_flights[:3])]
    dataset = read_dataset(paths, arpl_250g, hold_out="flight_0*")
    assert {s.flight for s in dataset.held_out} == {str(paths[0])}
    assert set(dataset.hashes) == {str(path) for path in paths[1:]}
    for pattern, which in (("nothing*", "none"), ("*", "all")):
        with pytest.raises(RequestError, match=which):
            read_dataset(paths, arpl_250g, hold_out=pattern)
