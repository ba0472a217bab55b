"""The scenario file: what it may contain, and how errors are refused."""

from __future__ import annotations

from pathlib import Path

import pytest

from dynamics.errors import RequestError
from sitl_mock.mock import MockOptions, build_autopilot, parse_parameter
from sitl_mock.scenario import parse_scenario, read_scenario
from sitl_mock.vehicle.vehicle import SimulatedVehicle
from vehicles import FOLDER

FULL = """
ground_height = 1.0
position = [2.0, 3.0]
yaw = 0.5
rotor_noise = 0.0
wind = { x = 3.0 }
battery = { cells = 4, capacity = 3600.0, resistance = 0.02, charge = 0.5 }
sensors = { delay = 0.03, gyro = 0.0 }
clock = { drift = 0.01 }
parameters = { COM_OF_LOSS_T = 0.5 }

[[effects]]
name = "rotor_drag"
parameters = { coefficient = 2e-5 }

[[faults]]
kind = "estimator_reset"
at = 5.0
after = "takeoff"
shift = [1.0, 0.0, 0.0]
yaw = 0.2

[[faults]]
kind = "packet_loss"
at = 7.0
duration = 2.0
probability = 0.1
"""


def test_everything_in_a_scenario_reaches_the_mock(tmp_path: Path) -> None:
    path = tmp_path / "scenario.toml"
    path.write_text(FULL)
    mock = build_autopilot(MockOptions(FOLDER / "px4_sih.toml", scenario=path))
    options = mock.vehicle.options  # type: ignore[attr-defined]
    assert {use.name for use in read_scenario(path, 4).hidden_effects()} == {"rotor_drag", "wind"}
    assert mock.vehicle.truth.position_world[:2] == pytest.approx([2.0, 3.0])
    assert (options.sensors.delay, options.ground_height) == (0.03, 1.0)
    assert mock.vehicle.battery.remaining == pytest.approx(0.5)
    assert mock.clock.drift == 0.01
    assert mock.parameters["COM_OF_LOSS_T"] == 0.5
    assert len(read_scenario(path, 4).faults) == 2


def test_an_empty_scenario_is_the_mock_without_one() -> None:
    assert parse_scenario("", 4).hidden_effects() == ()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("effect = 1", "did you mean 'effects'"),
        ("[sensors]\ndelai = 0.01", "did you mean 'delay'"),
        ("[sensors]\ndelay = -1.0", "0 or more"),
        ("[sensors]\ndelay = 2.0", "at most 0.5"),
        ("[[faults]]\nkind = 'estimator_rest'\nat = 1.0", "estimator_rest"),
        ("[[faults]]\nkind = 'link_down'\nat = 1.0\nduratoin = 2.0", "did you mean 'duration'"),
        ("[[faults]]\nkind = 'link_down'\nat = -1.0", "at >= 0"),
        ("[[faults]]\nkind = 'packet_loss'\nat = 1.0\nprobability = 2.0", "0 to 1"),
        ("[clock]\ndrift = 5.0", "-0.1 to 0.1"),
        ("[battery]\ncells = 0\ncapacity = 1.0\nresistance = 0.1", "at least one cell"),
        ("[[effects]]\nname = 'rotor_darg'", "did you mean 'rotor_drag'"),
        ("wind = { x = 3.0, w = 1.0 }", "unknown key 'w'"),
        ("not toml", "not valid TOML"),
        ("yaw = 'north'", "yaw"),
    ],
)
def test_what_is_not_possible_is_refused_by_name(text: str, message: str) -> None:
    with pytest.raises(RequestError, match=message):
        parse_scenario(text, 4)


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RequestError, match="cannot read the scenario"):
        read_scenario(tmp_path / "none.toml", 4)


def test_an_unknown_parameter_of_a_scenario_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "scenario.toml"
    path.write_text("parameters = { COM_OF_LOSS = 0.5 }")
    with pytest.raises(RequestError, match="COM_OF_LOSS_T"):
        build_autopilot(MockOptions(FOLDER / "px4_sih.toml", scenario=path))


def test_an_effect_that_changes_in_flight_must_be_there_from_the_start(tmp_path: Path) -> None:
    path = tmp_path / "scenario.toml"
    fault = "[[faults]]\nkind = 'effect'\nat = 1.0\nvalues = { 'mass.ratio' = 1.2 }\n"
    path.write_text(fault)
    with pytest.raises(RequestError, match=r"mass.ratio is not in the vehicle's model"):
        build_autopilot(MockOptions(FOLDER / "px4_sih.toml", scenario=path))
    path.write_text(f"{fault}[[effects]]\nname = 'mass'\nparameters = {{ ratio = 1.0 }}\n")
    mock = build_autopilot(MockOptions(FOLDER / "px4_sih.toml", scenario=path))
    vehicle = mock.vehicle
    assert isinstance(vehicle, SimulatedVehicle)
    constants, index = vehicle._constants["model"], vehicle.plant.model.parameter_names.index("mass.ratio")
    mock.advance(0.5)
    assert constants[index] == 1.0
    mock.advance(1.0)
    assert constants[index] == 1.2


def test_parameters_of_the_command_line() -> None:
    assert parse_parameter("COM_OF_LOSS_T=0.5") == ("COM_OF_LOSS_T", 0.5)
    with pytest.raises(RequestError, match="NAME=NUMBER"):
        parse_parameter("COM_OF_LOSS_T")


def test_the_same_seed_flies_the_same_flight() -> None:
    def flight(seed: int) -> list[bytes]:
        mock = build_autopilot(MockOptions(FOLDER / "px4_sih.toml", seed=seed))
        link = mock.add_link("test", "onboard")
        mock.advance(1.0)
        return [frame for frame in link.take(1.0) if frame[7:10] == (331).to_bytes(3, "little")]

    assert flight(3) == flight(3)
    assert flight(3) != flight(4)
