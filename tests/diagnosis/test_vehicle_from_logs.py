"""Vehicle files from logs: layout by the autopilot's parameters, constants from flights of known truth."""

import dataclasses
from pathlib import Path

import msgspec
import numpy as np
import pytest

from diagnosis.vehicle_check import check_vehicle
from diagnosis.vehicle_from_logs import LogVehicle, _open, vehicle_from_logs
from diagnosis.vehicle_identification import identify_vehicle
from dynamics.errors import DataError, RequestError
from dynamics.vehicle_file import find_vehicle, parse_vehicle, read_vehicle
from flights import Flight
from tests.support.simulated_flight import flown, without

SIH = Path("tests/data/px4_sih_flights")
ARM = 0.2 * np.sqrt(2)


@pytest.fixture(scope="module")
def sih() -> LogVehicle:
    return vehicle_from_logs([SIH / "textbook_1_circle.ulg.gz"], name="sih", mass=1.0, arm=ARM)


def test_a_file_from_px4s_log_holds_the_simulators_constants(sih: LogVehicle) -> None:
    identified = sih.identified
    assert identified is not None
    assert identified.thrust_curve is not None
    assert identified.motor_lag is not None
    truths = [
        (identified.thrust, 20.0),
        (identified.thrust_curve, 0.0),
        *((inertia, 0.025) for inertia in identified.inertia),
        (identified.yaw_gain, 1e-7 / 0.03),
        (identified.motor_lag, 0.05),
    ]
    for constant, truth in truths:
        assert abs(constant.value - truth) <= constant.half_width
        assert constant.half_width < 0.15 * max(abs(truth), 1.0)


def test_the_layout_is_the_parameters_in_the_order_in_which_logs_are_read(sih: LogVehicle) -> None:
    truth, rotors = read_vehicle(find_vehicle("px4_sih")).rotors, sih.draft.vehicle.rotors
    assert np.allclose(rotors.position, truth.position)
    assert rotors.spin == truth.spin
    assert rotors.motor == (3, 2, 4, 1)


def test_the_file_states_sources_intervals_and_what_is_open(sih: LogVehicle) -> None:
    text = sih.draft.toml
    assert parse_vehicle(text) == sih.draft.vehicle
    for words in ("# given", "CA_ROTORn_PX", "+-", "log esc_status"):
        assert words in text


def test_a_ratio_that_flights_show_alone_is_open(sih: LogVehicle) -> None:
    assert sih.identified is not None
    identified = dataclasses.replace(sih.identified, yaw_inertia=None)
    assert any(
        "torque constant and yaw inertia apart" in text
        for text in _open(sih.layout, identified, "", mass=1.0, speed=1e3)
    )


def test_without_a_mass_it_stays_open_and_nothing_is_a_vehicle() -> None:
    with pytest.raises(RequestError, match="--arm"):
        vehicle_from_logs([SIH / "textbook_1_circle.ulg.gz"], name="sih")
    draft = vehicle_from_logs([SIH / "refused_lying_61deg.ulg.gz"], name="sih", arm=ARM).draft
    assert not draft.is_complete
    assert any("weigh the vehicle" in text for text in draft.open)
    assert any("inertia, thrust and torque constants" in text for text in draft.open)
    with pytest.raises(RequestError, match=r"body\.mass is open"):
        _ = draft.vehicle


def test_a_log_without_a_layout_is_refused_with_what_to_do() -> None:
    with pytest.raises(DataError, match="alula vehicle new"):
        vehicle_from_logs(["tests/data/crazyflie/log20.gz"], name="v", mass=0.03, arm=0.04)


def test_a_table_without_parameters_gives_the_same_vehicle_by_its_frame(sih: LogVehicle, tmp_path: Path) -> None:
    table = Flight.read(SIH / "textbook_1_circle.ulg.gz").to_csv(tmp_path / "flight.csv")
    with pytest.raises(DataError, match="--frame"):
        vehicle_from_logs([table], name="sih", mass=1.0, arm=ARM)
    with pytest.raises(RequestError, match="--arm"):
        vehicle_from_logs([table], name="sih", mass=1.0, frame="quad_x")
    with pytest.raises(RequestError, match="arm = 225"):
        vehicle_from_logs([table], name="sih", mass=1.0, frame="quad_x", arm=225.0)
    made, other = (
        vehicle_from_logs([table], name="sih", mass=1.0, frame="quad_x", arm=ARM).draft.vehicle,
        sih.draft.vehicle,
    )
    assert np.allclose(made.rotors.position, other.rotors.position)
    assert (made.rotors.spin, made.rotors.motor) == (other.rotors.spin, other.rotors.motor)
    assert np.allclose(made.body.inertia, other.body.inertia, rtol=0.02)
    assert made.rotors.thrust_max == pytest.approx(other.rotors.thrust_max, rel=0.02)


def test_a_check_names_what_disagrees_and_by_how_much() -> None:
    vehicle = read_vehicle(find_vehicle("px4_sih"))
    rotors = msgspec.structs.replace(vehicle.rotors, position=tuple((y, x, z) for x, y, z in vehicle.rotors.position))
    checked = check_vehicle([SIH / "mass125_1_circle.ulg.gz"], vehicle)
    disagreeing = {number.name: number.text for number in checked.numbers if number.answer == "disagrees"}
    assert "or a mass of 1.2" in disagreeing["rotors.thrust_constant"]
    assert "effects.motor_lag.time_constant" not in disagreeing
    turned = check_vehicle([SIH / "refused_lying_61deg.ulg.gz"], msgspec.structs.replace(vehicle, rotors=rotors))
    assert {n.name for n in turned.numbers if n.answer == "disagrees"} == {
        "position of rotor 1 (PX4 motor 2)",
        "position of rotor 3 (PX4 motor 1)",
    }


def test_yaw_inertia_and_torque_constant_are_told_apart_where_the_vehicle_turns_about_several_axes() -> None:
    vehicle = read_vehicle(find_vehicle("px4_sih"))
    body = msgspec.structs.replace(vehicle.body, inertia=(0.025, 0.025, 0.04))
    rotors = msgspec.structs.replace(vehicle.rotors, torque_constant=vehicle.rotors.torque_constant * 4 / 3)
    scaled = msgspec.structs.replace(vehicle, body=body, rotors=rotors)  # the ratio is right
    checked = check_vehicle([SIH / "nothing_3_warped_ellipse_2.ulg.gz"], scaled)
    yaw = next(number for number in checked.numbers if number.name == "body.inertia about z")
    assert yaw.answer == "disagrees"
    assert yaw.logs == pytest.approx(0.03, rel=0.06)
    assert {n.name for n in checked.numbers if n.answer == "disagrees"} == {yaw.name}


def test_measured_rotor_speeds_give_the_thrust_constant() -> None:
    truth = read_vehicle(find_vehicle("arpl_250g"))
    body = msgspec.structs.replace(truth.body, inertia=(6.6e-4, 5.4e-4, 1.1e-3))
    rotors = msgspec.structs.replace(truth.rotors, thrust_constant=6e-7)
    start = msgspec.structs.replace(truth, body=body, rotors=rotors)
    flight = Flight.from_log(without(flown().log, "rotor_command", "rotor_speed_command"), rate=100.0)
    identified = identify_vehicle([flight], start)
    assert identified.is_measured
    assert abs(identified.thrust_constant.value - truth.rotors.thrust_constant) <= identified.thrust_constant.half_width
    for inertia, value in zip(identified.inertia, truth.body.inertia, strict=False):
        assert abs(inertia.value - value) <= inertia.half_width
