"""Tables of public flights, with the headers that their files have, are read without a mapping being named."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pa_parquet
import pytest
from numpy.testing import assert_allclose

from dynamics import quaternion
from dynamics.arrays import Floats
from dynamics.errors import DataError, RequestError
from dynamics.vehicle import Vehicle
from flights import Flight, read_log
from tests.support.flight_files import Truth, manoeuvre

# The script that made NeuroBEM's files writes this header; its page says which motor is where.
NEUROBEM_HEADER = (
    "t,ang acc x,ang acc y,ang acc z,ang vel x,ang vel y,ang vel z,quat x,quat y,quat z,quat w,acc x,acc y,acc z,"
    "vel x,vel y,vel z,pos x,pos y,pos z,mot 1,mot 2,mot 3,mot 4,dmot 1,dmot 2,dmot 3,dmot 4,vbat"
)
NEUROBEM_MOTORS = {"mot 1": (-1, -1), "mot 2": (1, -1), "mot 3": (-1, 1), "mot 4": (1, 1)}  # signs of x and y
# A Crazyflie's motors are numbered from the front right over the back right.
IDSIA_HEADER = (
    ",Unnamed: 0,t,x,y,z,qx,qy,qz,qw,yaw,pitch,roll,vx,vy,vz,wx,wy,wz,ros_timestamp,x_poses,qx_poses,m1_thrust,"
    "m1_erpm,m2_erpm,m3_erpm,m4_erpm,thrust,ax,ay,az,x_r,vx_r,Vbat,is_flying,m1_rads,m1_rads2,m2_rads,m2_rads2,"
    "m3_rads,m3_rads2,m4_rads,m4_rads2,rx,ry,rz"
)
IDSIA_MOTORS = {"m1_rads": (1, -1), "m2_rads": (-1, -1), "m3_rads": (-1, 1), "m4_rads": (1, 1)}

Columns = Mapping[str, Floats]


@pytest.fixture(scope="module")
def truth() -> Truth:
    return manoeuvre()


def _vectors(names: Sequence[str], values: Floats) -> dict[str, Floats]:
    return dict(zip(names, values.T, strict=True))


def _motors(places: Mapping[str, tuple[int, int]], truth: Truth, vehicle: Vehicle) -> dict[str, Floats]:
    """The speed of the rotor that sits where a motor does."""
    signs = [(np.sign(x), np.sign(y)) for x, y, _ in vehicle.rotors.position]
    return {motor: truth.rotor_speed[:, signs.index(place)] for motor, place in places.items()}


def _table(header: str, columns: Columns, rows: int) -> dict[str, Floats]:
    """All columns of a header in its order; what a test says nothing of is no number that could pass for one."""
    return {name: columns.get(name, np.full(rows, 1e6)) for name in header.split(",")}


def neurobem_table(truth: Truth, vehicle: Vehicle) -> dict[str, Floats]:
    body_velocity = quaternion.rotate_inverse(truth.attitude, truth.velocity)
    return _table(
        NEUROBEM_HEADER,
        {
            "t": truth.time,
            **_vectors([f"ang vel {axis}" for axis in "xyz"], truth.rate),
            **_vectors([f"quat {axis}" for axis in "wxyz"], truth.attitude),
            **_vectors([f"acc {axis}" for axis in "xyz"], truth.specific_force),
            **_vectors([f"vel {axis}" for axis in "xyz"], body_velocity),
            **_vectors([f"pos {axis}" for axis in "xyz"], truth.position),
            **_motors(NEUROBEM_MOTORS, truth, vehicle),
            "vbat": np.full(len(truth.time), 15.8),
        },
        len(truth.time),
    )


def idsia_table(truth: Truth, vehicle: Vehicle) -> dict[str, Floats]:
    return _table(
        IDSIA_HEADER,
        {
            "t": truth.time,
            **_vectors(["x", "y", "z"], truth.position),
            **_vectors(["vx", "vy", "vz"], truth.velocity),
            **_vectors(["qw", "qx", "qy", "qz"], truth.attitude),
            **_vectors(["wx", "wy", "wz"], truth.rate),
            **_motors(IDSIA_MOTORS, truth, vehicle),
            "Vbat": np.full(len(truth.time), 3.7),
        },
        len(truth.time),
    )


def _csv(table: Columns, path: Path) -> Path:
    np.savetxt(path, np.column_stack(list(table.values())), delimiter=",", header=",".join(table), comments="")
    return path


def _parquet(table: Columns, path: Path) -> Path:
    pa_parquet.write_table(pa.table({name: values for name, values in table.items() if name}), path)
    return path


@pytest.mark.parametrize("write", [_csv, _parquet])
@pytest.mark.parametrize(
    ("table", "mapping", "pose", "quantities"),
    [
        (neurobem_table, "neurobem", "motion_capture", ("position", "rate")),
        (idsia_table, "idsia_nanodrone", "estimator", ("position", "velocity", "rate")),
    ],
)
def test_each_motor_and_axis_is_where_its_authors_say(
    tmp_path, truth, arpl_250g, table, mapping, pose, quantities, write
) -> None:
    log = read_log(write(table(truth, arpl_250g), tmp_path / "flight.bin"))
    assert log.metadata["mapping"] == mapping
    assert log.metadata["pose_source"] == pose
    for name in (*quantities, "rotor_speed"):
        stream = log.stream(name)
        assert stream is not None
        assert_allclose(stream.values, getattr(truth, name), rtol=1e-9, atol=1e-9, err_msg=name)
    attitude = log.stream("attitude")
    assert attitude is not None
    assert quaternion.angle_between(attitude.values, truth.attitude).max() < 1e-6
    assert log.stream("specific_force") is None, "the column is no accelerometer's"


@pytest.mark.parametrize("write", [_csv, _parquet])
def test_idsias_table_before_its_processing_has_the_motors_commands(tmp_path, truth, arpl_250g, write) -> None:
    """It holds shares of full command and eRPM, and no speeds: the processing makes those."""
    table = {name: values for name, values in idsia_table(truth, arpl_250g).items() if "_rads" not in name}
    places = {motor.replace("rads", "thrust"): place for motor, place in IDSIA_MOTORS.items()}
    commands = {motor: speed / 2000.0 for motor, speed in _motors(places, truth, arpl_250g).items()}
    log = read_log(write({**table, **commands}, tmp_path / "flight.bin"))
    assert log.metadata["mapping"] == "idsia_nanodrone_raw"
    command = log.stream("rotor_command")
    assert command is not None
    assert_allclose(command.values, truth.rotor_speed / 2000.0, rtol=1e-9)


def test_a_table_that_lacks_one_column_is_not_that_sets(tmp_path, truth, arpl_250g) -> None:
    table = neurobem_table(truth, arpl_250g)
    del table["vbat"]
    with pytest.raises(RequestError, match="neither those of the flight CSV nor those of a known mapping"):
        Flight.read(_csv(table, tmp_path / "flight.csv"))


def test_a_torn_parquet_file_says_so_with_a_mapping_and_without(tmp_path, truth, arpl_250g) -> None:
    path = _parquet(neurobem_table(truth, arpl_250g), tmp_path / "flight.parquet")
    path.write_bytes(path.read_bytes()[:2000])
    mapping = Path(__file__).parents[2] / "flights" / "mappings" / "neurobem.toml"
    for named in (None, mapping):
        with pytest.raises(DataError, match="torn or damaged"):
            read_log(path, mapping=named)


def test_a_parquet_table_of_other_names_is_told_of_mappings(tmp_path) -> None:
    path = _parquet({"stamp": np.arange(9.0), "height": np.ones(9)}, tmp_path / "flight.parquet")
    with pytest.raises(DataError, match=r"has the columns stamp, height; .* or give a column mapping"):
        read_log(path)
