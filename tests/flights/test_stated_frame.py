"""A frame that the user states: each column of a log gets the place of the motor that it is, by the log's own order."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from diagnosis.vehicle_from_logs import layout_of
from dynamics.autopilot_frames import FRAMES
from dynamics.errors import RequestError
from flights import Flight
from flights.rotor_layout import RotorLayout, rotor_layout
from flights.stated_frame import stated_layout
from tests.support.flight_files import dataflash_log, flight_csv, manoeuvre

PLACES = {(1, 1): "front left", (-1, 1): "back left", (-1, -1): "back right", (1, -1): "front right"}
TURNS = {"front left": 1, "back left": -1, "back right": 1, "front right": -1}  # sign of the reaction torque


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> Flight:
    return Flight.read(flight_csv(manoeuvre(), tmp_path_factory.mktemp("logs") / "flight.csv"))


def _dataflash(path: Path, *, states_frame: bool) -> Flight:
    content = dataflash_log(manoeuvre())
    path.write_bytes(content if states_frame else content.replace(b"FRAME_", b"OTHER_"))
    return Flight.read(path)


def _by_place(layout: RotorLayout) -> dict[str, int]:
    places = [PLACES[int(np.sign(x)), int(np.sign(y))] for x, y, _ in layout.position]
    assert dict(zip(places, layout.spin, strict=True)) == TURNS
    return dict(zip(places, layout.motor, strict=True))


@pytest.mark.parametrize(
    ("autopilot", "motors"),
    [
        (None, {"front right": 1, "back left": 2, "front left": 3, "back right": 4}),
        ("px4", {"front right": 1, "back left": 2, "front left": 3, "back right": 4}),
        ("ArduPilot", {"front right": 1, "back left": 2, "front left": 3, "back right": 4}),
        ("crazyflie", {"front right": 1, "back right": 2, "back left": 3, "front left": 4}),
        ("betaflight", {"back right": 1, "front right": 2, "back left": 3, "front left": 4}),
    ],
)
def test_the_autopilot_numbers_the_motors(table: Flight, autopilot: str | None, motors: dict[str, int]) -> None:
    layout = stated_layout([table], "quad_x", autopilot)
    assert _by_place(layout) == motors
    assert np.allclose(layout.position, FRAMES["quad_x"].direction)  # a table's columns are in our order


def test_an_ardupilot_log_without_its_frame_holds_motors_in_the_order_of_their_numbers(tmp_path: Path) -> None:
    bare, full = _dataflash(tmp_path / "a.bin", states_frame=False), _dataflash(tmp_path / "b.bin", states_frame=True)
    layout, logged = stated_layout([bare], "quad_x"), rotor_layout(full.parameters)
    assert logged is not None
    assert (layout.autopilot, layout.motor) == ("ArduPilot", (1, 2, 3, 4))
    assert _by_place(layout) == _by_place(logged)
    for motor in range(1, 5):  # the same speeds belong to the same place
        mine, stated = layout.motor.index(motor), logged.motor.index(motor)
        assert layout.position[mine] == logged.position[stated]
        np.testing.assert_allclose(bare["rotor_speed"][:, mine], full["rotor_speed"][:, stated])


def test_parameters_that_state_a_layout_count_and_a_frame_may_not_contradict_them(tmp_path: Path) -> None:
    full = _dataflash(tmp_path / "b.bin", states_frame=True)
    assert not layout_of([full], "quad_x").is_given
    for frame in ("quad_plus", "quad_h"):
        with pytest.raises(RequestError, match="Leave --frame out"):
            layout_of([full], frame)


@pytest.mark.parametrize(
    ("frame", "autopilot", "words"),
    [
        ("quadx", None, "did you mean 'quad_x'"),
        ("tricopter", None, "Known: quad_x, quad_plus, quad_h, hexa_x"),
        ("hexa_x", None, r"has 4 rotors, and a hexa_x has 6.*quad_x, quad_plus, quad_h"),
        ("octo_x", None, r"has 4 rotors, and a octa_x has 8"),
        ("quad_x", "naza", "Known: px4, ardupilot, crazyflie, betaflight"),
        ("quad_plus", "betaflight", "known for a quad_x"),
    ],
)
def test_a_frame_that_does_not_fit_is_refused(table: Flight, frame: str, autopilot: str | None, words: str) -> None:
    with pytest.raises(RequestError, match=words):
        stated_layout([table], frame, autopilot)


def test_motor_numbers_without_a_frame_are_refused(table: Flight) -> None:
    with pytest.raises(RequestError, match="Give both"):
        layout_of([table], None, "px4")
