"""Real flights through the command line: effects measured elsewhere are named, and nothing beyond what they show."""

from __future__ import annotations

import gzip
import json
import re
from pathlib import Path

import msgspec
import numpy as np
import pytest

from diagnosis.data.command_curve import fit_command_curve
from diagnosis.data.segment import segments
from dynamics.vehicle import EffectUse, Vehicle
from dynamics.vehicle_file import read_vehicle, write_vehicle
from flights import Flight
from tests.support.command_line import Run, command_line
from vehicles import FOLDER

DATA = Path(__file__).parents[1] / "data"
LEE = [DATA / "crazyflie" / "log20.gz", *(DATA / "imrc_lee_crazyflie" / f"log{n}.gz" for n in ("54", "100", "136_2"))]
TRIM = DATA / "crazypad_trim"
E8 = [f"--normal={TRIM / name}" for name in ("normal_flight_E8_log00.csv.gz", "normal_flight_E8_log03.csv.gz")]
E9 = [f"--normal={TRIM / 'normal_flight_E9_log00.csv.gz'}"]

# From the log's own columns: its commanded moments over its commanded thrusts give arms and turning directions.
X8 = """
name = "acsl_x8"
[body]
mass = 2.5
inertia = [0.03, 0.03, 0.04]
[rotors]
position = [
  [0.0881, -0.1083, 0.0], [0.0881, 0.1083, 0.0], [-0.0881, 0.1083, 0.0], [-0.0881, -0.1083, 0.0],
  [0.0881, 0.1083, 0.0], [0.0881, -0.1083, 0.0], [-0.0881, -0.1083, 0.0], [-0.0881, 0.1083, 0.0],
]
spin = [-1, 1, -1, 1, -1, 1, -1, 1]
thrust_constant = 2.5e-6
torque_constant = 2.5e-8
speed_max = 2000.0
radius = 0.0635
"""


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    return command_line(monkeypatch, capsys)


@pytest.fixture(scope="module")
def upgraded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The Crazyflie with upgraded motors and 37 g, as the Lee-controller flights have it."""
    vehicle = read_vehicle(FOLDER / "crazyflie.toml")
    body = msgspec.structs.replace(vehicle.body, mass=0.037)
    rotors = msgspec.structs.replace(vehicle.rotors, speed_max=3300.0)
    changed = msgspec.structs.replace(vehicle, name="crazyflie_upgraded", body=body, rotors=rotors)
    return write_vehicle_to(tmp_path_factory.mktemp("vehicle") / "upgraded.toml", changed)


def write_vehicle_to(path: Path, vehicle: Vehicle) -> Path:
    write_vehicle(vehicle, path)
    return path


def test_motors_in_the_crazyflies_own_order_are_noticed(run: Run, tmp_path: Path) -> None:
    """Motors 1 to 4 instead of the file's rotors 0 to 3, in a flight that shows them through their lag alone."""
    with gzip.open(DATA / "arpl_crazyflie" / "log10_cut.csv.gz", "rt") as file:
        header, *rows = file.read().splitlines()
    renamed = header
    for rotor in range(4):
        renamed = renamed.replace(f"rotor_command_{rotor}", f"ROTOR_COMMAND_{3 - rotor}")
    log = tmp_path / "log.csv"
    log.write_text("\n".join([renamed.lower(), *rows]))
    code, _, wrong = run("diagnose", log, "--vehicle", "crazyflie")
    assert code == 3
    assert "columns [3, 2, 1, 0] are the file's rotors [0, 1, 2, 3]" in wrong


def test_a_log_without_pose_is_compared_in_what_it_has(run: Run) -> None:
    log = DATA / "arpl_crazyflie" / "log10_cut.csv.gz"
    code, shown, _ = run("compare", log, "--vehicle", "crazyflie", "--json", "-")
    assert code == 0
    answer = json.loads(shown)
    assert {axis["kind"] for axis in answer["axes"]} == {"imu", "angular"}
    names = {regime["name"] for regime in answer["maps"]}
    assert {"thrust over weight", "body rate rad/s", "time s"} <= names
    assert not {"speed m/s", "height m", "east m"} & names
    assert answer["open_loop"] == []


def test_a_drag_of_the_vehicle_file_leaves_less_to_explain(run: Run, upgraded: Path, tmp_path: Path) -> None:
    vehicle = read_vehicle(upgraded)
    with_drag = write_vehicle_to(
        tmp_path / "with_drag.toml", vehicle.with_effects(EffectUse("linear_drag", {"coefficient": 0.33 * 0.037}))
    )
    errors = []
    for file in (upgraded, with_drag):
        code, shown, _ = run("compare", *LEE, "--vehicle", file, "--json", "-")
        assert code == 0
        axes = {(a["kind"], a["axis"]): a["rms"] for a in json.loads(shown)["axes"]}
        errors.append(axes["mocap", "y"])
    assert errors[1] < 0.75 * errors[0]


def test_a_log_without_gyro_and_pitch_is_refused_with_what_it_lacks(run: Run) -> None:
    code, _, wrong = run("diagnose", DATA / "crazyflie" / "E8_log00.gz", "--vehicle", "crazyflie")
    assert code == 3
    assert "it lacks attitude, gyro, accelerometer" in wrong
    assert "--normal" in wrong


@pytest.mark.parametrize(
    ("log", "normal", "min_loss"),
    [
        ("add_weight_W3_near_M3_E9_log02", E9, 0.2),
        ("cut_propeller_M3_3mm_E8_log01", E8, 0.08),
        ("cut_propeller_M3_3mm_E9_log00", E9, 0.06),
    ],
)
def test_a_rotor_that_works_harder_than_in_normal_flights_is_flagged(
    run: Run, log: str, normal: list[str], min_loss: float
) -> None:
    code, shown, _ = run("diagnose", TRIM / f"{log}.csv.gz", "--vehicle", "crazyflie", *normal, "--json", "-")
    assert code == 0
    answer = json.loads(shown)
    assert answer["verdict"] == "ambiguous"
    (effect,) = answer["effects"]
    assert (effect["name"], effect["rotor"]) == ("weak_rotor", 1)  # motor 3 of the Crazyflie
    assert effect["ambiguous_with"] == ["centre_of_mass"]
    assert effect["parameters"]["loss"]["value"] > min_loss
    x, y = answer["centre_of_mass_moved"]
    assert x < 0 < y  # motor 3 is behind on the left
    assert "exchange the propeller of rotor 1 (back left;" in answer["next_flight"]


def test_tape_and_normal_flights_are_not_claimed_to_be_anything(run: Run) -> None:
    for log, normal in (
        ("tape_on_propeller_M3_E8_log00", E8),
        ("normal_flight_E8_log00", E8[1:]),
        ("normal_flight_E8_log03", E8[:1]),
    ):
        code, shown, _ = run("diagnose", TRIM / f"{log}.csv.gz", "--vehicle", "crazyflie", *normal)
        assert code == 0
        assert shown.startswith("explained: No rotor works harder")
        assert "normal flight" in shown


def test_px4_motors_at_10_hz_are_answered_with_the_profile_to_set(run: Run) -> None:
    log = DATA / "px4_sih_offboard" / "offboard_hover_topics.ulg.gz"
    code, _, wrong = run("diagnose", log, "--vehicle", "px4_sih")
    assert code == 3
    assert "rotor_command at 10 Hz" in wrong
    assert "SDLOG_PROFILE from 131 to 155" in wrong
    code, _, wrong = run("compare", DATA / "pyulog_samples" / "sample_px4_events.ulg.gz", "--vehicle", "px4_sih")
    assert code == 3
    assert "rotor_speed at 4 Hz, rotor_command at 10 Hz" in wrong


def test_a_hover_is_refused_as_too_gentle(run: Run) -> None:
    """PX4's flight again, by its telemetry with motors at 50 Hz; the time on the ground is left out."""
    log = DATA / "px4_sih_offboard" / "offboard_hover.tlog.gz"
    code, _, wrong = run("diagnose", log, "--vehicle", "px4_sih")
    assert code == 3
    assert "too gentle: 0.22 m/s horizontally and 0.08 rad/s" in wrong
    assert "Fly straight accelerations" in wrong
    vehicle = read_vehicle(FOLDER / "px4_sih.toml")
    (flown,) = segments(Flight.read(log), vehicle)
    assert flown.start + flown.duration < 54  # it touches down at 53.7 s and reports it at 62 s
    (gain,) = fit_command_curve([flown], (), vehicle).gains.values()
    assert gain.mean == pytest.approx(1.0, abs=0.02)  # SIH's thrust is that of the file


def test_eight_rotors_with_commanded_thrusts_are_read_and_refused_as_too_short(run: Run, tmp_path: Path) -> None:
    file = tmp_path / "x8.toml"
    file.write_text(X8)
    log = DATA / "acsl_x8copter" / "log_20240613_115633_cut.log.gz"
    code, _, wrong = run("diagnose", log, "--vehicle", file)
    assert code == 3
    assert re.search(r"\d+ s of flight are too short", wrong)
    parts = segments(Flight.read(log), read_vehicle(file))
    curve = fit_command_curve(parts, (), read_vehicle(file))
    (gain,) = curve.gains.values()
    assert gain.mean == pytest.approx(0.92, abs=0.05)  # 2.3 to 2.7 kg are carried by 2.7 kg of commanded thrust
    np.testing.assert_allclose(gain.motors, 1.0, atol=0.25)
