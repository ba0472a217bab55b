"""Logs of every format that `alula inspect` and `alula diagnose` take, whole or in chunks."""

from __future__ import annotations

import contextlib
import gzip
import io
import sqlite3
import zipfile
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pandas
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer
from rosbags.rosbag2 import StoragePlugin

from dynamics.errors import AlulaError
from fixtures.ulog_file import Topic, ulog_file
from flights import Flight, read_log
from flights.folder import is_log
from flights.followed import read_followed
from flights.one_flight import read_one_flight
from flights.reading import read_chunks
from tests.fuzz.mutation import Parts
from tests.fuzz.target import Target, files_in_folder
from tests.support.blackbox_table import columns_of, inav_columns, text_of
from tests.support.flight_files import crazyflie_log, dataflash_log, flight_csv, manoeuvre, paper_bag, ros2_bag, tlog
from tests.support.px4_bag import ODOMETRY, px4_bag

DATA = Path(__file__).parents[2] / "data"
CHUNK = 0.1  # s
BLOCKS = ("imu.csv", "stabilizer.csv")
TRUTH = manoeuvre(duration=0.25, rate=40.0)


def read(path: Path) -> object:
    """Everything that is done with a log before it is diagnosed, whatever its parts refuse."""
    is_log(path)
    errors: list[AlulaError] = []
    for step in (_flight, _chunks):
        try:
            step(path)
        except AlulaError as error:
            errors.append(error)
    if errors:
        raise errors[0]
    return None


def _flight(path: Path) -> None:
    log = read_log(path)
    for stream in log.streams:
        assert (np.diff(stream.time) > 0).all()
        assert np.isfinite(stream.time).all()
        assert len(stream.time) == len(stream.values)
    Flight.from_log(log)


def _chunks(path: Path) -> None:
    """At most a few: a stamp that was changed makes a log of years."""
    for _, _ in zip(range(20), read_chunks(path, CHUNK), strict=False):
        pass


def _one(name: str, data: bytes) -> list[Parts]:
    return [{name: data}]


def _ulog(_: Path) -> list[Parts]:
    stamps = (np.arange(12) * 20_000 + 1_000_000).astype(np.uint64)
    quaternions = np.tile(np.array([1, 0, 0, 0], np.float32), (12, 1))
    topics = [
        Topic("vehicle_attitude", {"timestamp": stamps, "timestamp_sample": stamps, "q": quaternions}),
        Topic("vehicle_angular_velocity", {"timestamp": stamps, "timestamp_sample": stamps, "xyz": quaternions[:, :3]}),
        Topic("sensor_combined", {
            "timestamp": stamps, "gyro_rad": quaternions[:, :3], "accelerometer_m_s2": quaternions[:, :3],
        }),
        Topic("actuator_motors", {"timestamp": stamps, "control": np.full((12, 12), 0.5, np.float32)}),
        Topic("esc_status", {"timestamp": stamps, "esc_rpm": np.full((12, 4), 9000, np.int32)}),
        Topic("vehicle_local_position", {
            "timestamp": stamps,
            **{name: np.zeros(12, np.float32) for name in ("x", "y", "z", "vx", "vy", "vz", "heading")},
            **{name: np.ones(12, np.uint8) for name in ("xy_valid", "z_valid", "v_xy_valid", "v_z_valid")},
        }),
        Topic("vehicle_visual_odometry", {
            "timestamp": stamps, "timestamp_sample": stamps, "position": quaternions[:, :3], "q": quaternions,
            "velocity": quaternions[:, :3],
            **{name: np.ones(12, np.uint8) for name in ("pose_frame", "velocity_frame")},
        }),
        Topic("battery_status", {"timestamp": stamps, "voltage_v": np.full(12, 11.1, np.float32)}),
    ]  # fmt: skip
    parameters = {"CA_ROTOR_COUNT": 4, **{f"CA_ROTOR{i}_P{axis}": 0.1 for i in range(4) for axis in "XY"}}
    sample = gzip.decompress((DATA / "pyulog_samples" / "sample_log_small.ulg.gz").read_bytes())
    return [*_one("flight.ulg", ulog_file(topics, parameters)), *_one("flight.ulg", sample[:90_000])]


def _csv(folder: Path) -> list[Parts]:
    plain = flight_csv(TRUTH, folder / "flight.csv").read_bytes()
    return [*_one("flight.csv", plain), *_one("flight.csv", plain.replace(b",", b";")), {"flight.csv": _sparse(plain)}]


def _sparse(plain: bytes) -> bytes:
    """A log whose cells are blank now and then, with quantities beside those of the pose."""
    head, *rows = plain.decode().splitlines()
    rows = [f"{row},{'' if i % 2 else 11.1},1" for i, row in enumerate(rows)]
    return "\n".join([f"{head},battery_voltage,armed", *rows]).encode()


def _rows_of(file: Path, rows: int) -> bytes:
    return b"\n".join(gzip.decompress(file.read_bytes()).split(b"\n")[:rows])


def _mapped(_: Path) -> list[Parts]:
    files = (
        "nanobench/B3_figure8_fast_rep1.csv.gz", "arpl_crazyflie/log10_cut.csv.gz", "crazyflie/log20.csv.gz",
        "acsl_x8copter/log_20240613_115633_cut.log.gz", "crazypad_trim/normal_flight_E8_log00.csv.gz",
    )  # fmt: skip
    return [{"table.csv": _rows_of(DATA / file, 25)} for file in files]


def _parquet(folder: Path) -> list[Parts]:
    table = pandas.read_csv(flight_csv(TRUTH, folder / "flight.csv"))
    table.to_parquet(folder / "flight.parquet")
    return _one("flight.parquet", (folder / "flight.parquet").read_bytes())


def _crazyflie(_: Path) -> list[Parts]:
    variables = [*((f"stateEstimateZ.{axis}", "h") for axis in "xyz"), ("pm.vbat", "f")]
    rows = [(time, (1, 2, 3, 3.7)) for time in range(0, 200_000, 10_000)]
    real = gzip.decompress((DATA / "imrc_lee_crazyflie" / "log54.gz").read_bytes())
    logs = [crazyflie_log(variables, rows, version=version) for version in (1, 2)]
    return [{"log00": data} for data in (*logs, real[:20_000])]


def _blackbox(_: Path) -> list[Parts]:
    stated = "H Firmware revision:Betaflight 4.5.1\nH acc_1G:2048\nH motorOutput:158,2047\nH gyro_scale:0x3f800000\n"
    plain, quoted = text_of(columns_of(TRUTH)), text_of(columns_of(TRUTH), preamble=stated, quoted=True)
    return [{"LOG00001.01.csv": text.encode()} for text in (plain, quoted, text_of(inav_columns(TRUTH)))]


def _log_variables(_: Path) -> list[Parts]:
    folder = DATA / "cfclient"
    return [{"block.csv": b"\n".join((folder / name).read_bytes().split(b"\n")[:25])} for name in BLOCKS]


def _blocks(_: Path) -> list[Parts]:
    folder = DATA / "cfclient"
    return [{name: b"\n".join((folder / name).read_bytes().split(b"\n")[:25]) for name in BLOCKS}]


def _read_blocks(path: Path) -> object:
    return Flight.from_log(read_one_flight(sorted(path.iterdir())))


LISTS = """name = "lists"
[time]
column = "sec"
fraction = "nanosec"
[frames]
world = "ENU"
body = "FLU"
[[streams]]
quantity = "position"
columns = ["p[0]", "p[1]", "p[2]"]
[[streams]]
quantity = "attitude"
columns = ["q[0]", "q[1]", "q[2]"]
order = "xyz"
[[streams]]
quantity = "rotor_command"
columns = ["m[0]", "m[1]", "m[2]", "m[3]"]
unit = "48..2047"
"""


def _lists(_: Path) -> list[Parts]:
    upright = TRUTH.attitude[:, 1:] * np.sign(TRUTH.attitude[:, :1])
    rows = zip(TRUTH.time, TRUTH.position, upright, TRUTH.rotor_speed, strict=True)
    cells = [f'{17 * 10**8},{time * 1e9:.0f},"{p.tolist()}","{q}","{m.tolist()}"' for time, p, q, m in rows]
    return _one("lists.csv", "\n".join(["sec,nanosec,p,q,m", *cells]).encode())


def _read_lists(path: Path) -> object:
    mapping = path.with_name("mapping.toml")
    mapping.write_text(LISTS)
    for _ in zip(range(20), read_chunks(path, CHUNK, mapping=mapping), strict=False):
        pass
    return Flight.from_log(read_log(path, mapping=mapping))


def _forms(folder: Path) -> list[Parts]:
    table = pandas.read_csv(flight_csv(TRUTH, folder / "flight.csv"))
    milliseconds = table.assign(t=np.rint(1e3 * table["t"]).astype(int))
    clock = table.assign(t=[f"2026-04-01T10:22:{31 + time:06.3f}" for time in table["t"]])
    texts = (
        table.to_csv(sep=";", decimal=",", index=False),
        milliseconds.to_csv(index=False),
        clock.to_csv(index=False),
    )
    return [{"flight.csv": text.encode()} for text in texts]


def _zip(folder: Path) -> list[Parts]:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as packed:
        packed.writestr("notes.txt", "windy")
        packed.write(flight_csv(TRUTH, folder / "flight.csv"), "day/flight.csv")
    return _one("flight.zip", stream.getvalue())


def _px4_bag(folder: Path) -> list[Parts]:
    messages = (*ODOMETRY, "EscStatus", "VehicleStatus")
    made = px4_bag(TRUTH, folder / "bag", messages, storage=StoragePlugin.SQLITE3)
    parts = {file.name: file.read_bytes() for file in made.iterdir()}
    with sqlite3.connect(next(made.glob("*.db3"))) as database:
        rows = database.execute("select id, data from messages order by id").fetchall()
    database.close()
    return [parts | {f"row {number}": data for number, data in rows}]


def _encrypted(_: Path) -> list[Parts]:
    return _one("flight.ulge", b"ULogEnc\x01" + bytes(range(200)))


def _betaflight(_: Path) -> list[Parts]:
    return _one(
        "LOG00001.BFL", b"H Product:Blackbox flight data recorder by Nicholas Sherlock\nH Data version:2\n" + bytes(99)
    )


def _tlog(_: Path) -> list[Parts]:
    return [{"flight.tlog": tlog(TRUTH)}, {"flight.tlog": tlog(TRUTH, body_velocity=True)}]


def _bag(folder: Path) -> list[Parts]:
    return _one("flight.bag", paper_bag(TRUTH, folder / "flight.bag").read_bytes())


def _bag2(storage: StoragePlugin, folder: Path) -> list[Parts]:
    made = ros2_bag(TRUTH, folder / "bag", body_velocity=False, storage=storage)
    return [{file.name: file.read_bytes() for file in sorted(made.iterdir())}]


def _gzip(folder: Path) -> list[Parts]:
    return _one("flight.csv.gz", gzip.compress(flight_csv(TRUTH, folder / "flight.csv").read_bytes(), mtime=0))


RECORDED = DATA / "recorded_flight" / "flight.mcap"
ROWS_A_TOPIC = 6


def recorded_messages() -> dict[str, bytes]:
    """The first messages of each topic of a recorded flight, its metadata and its attachments, by place and name."""
    parts: dict[str, bytes] = {}
    topics: dict[int, str] = {}
    counts: dict[str, int] = {}
    with RECORDED.open("rb") as file:
        for record in StreamReader(file).records:
            kind = type(record).__name__
            if kind == "Channel":
                topics[record.id] = record.topic
            elif kind == "Message":
                topic = topics[record.channel_id]
                counts[topic] = counts.get(topic, 0) + 1
                if counts[topic] <= ROWS_A_TOPIC:
                    parts[f"{len(parts):04d} message {topic} {record.log_time}"] = record.data
            elif kind == "Metadata":
                for name, value in record.metadata.items():
                    parts[f"{len(parts):04d} metadata {record.name} {name}"] = value.encode()
            elif kind == "Attachment":
                parts[f"{len(parts):04d} attachment {record.name}"] = record.data
    return parts


def mcap_of(parts: Parts, folder: Path) -> Path:
    """A recording of mutated messages with right checksums: the damage is in what was written, not on the disk."""
    stream = io.BytesIO()
    writer = Writer(stream, compression=CompressionType.NONE)
    writer.start(profile="", library="")
    schema = writer.register_schema("any", "jsonschema", b"{}")
    channels: dict[str, int] = {}
    metadata: dict[str, dict[str, str]] = {}
    for key, data in sorted(parts.items()):
        _, kind, name, *rest = key.split(" ", 3)
        if kind == "message":
            if name not in channels:
                channels[name] = writer.register_channel(name, "json", schema)
            writer.add_message(channels[name], int(rest[0]), data, int(rest[0]))
        elif kind == "metadata":
            metadata.setdefault(name, {})[rest[0]] = data.decode(errors="replace")
        else:
            writer.add_attachment(0, 0, " ".join([name, *rest]), "text/plain", data)
    for name, entries in metadata.items():
        writer.add_metadata(name, entries)
    writer.finish()
    (folder / "flight.mcap").write_bytes(stream.getvalue())
    return folder / "flight.mcap"


def _mcap(folder: Path) -> list[Parts]:
    return _one("flight.mcap", mcap_of(recorded_messages(), folder).read_bytes())


def _recorded(_: Path) -> list[Parts]:
    return [recorded_messages()]


def _sqlite(parts: Parts, folder: Path) -> Path:
    """A ROS 2 bag whose messages are mutated inside of a database that is whole, or was."""
    path = files_in_folder({name: data for name, data in parts.items() if not name.startswith("row ")}, folder)
    rows = [(data, int(name.split()[1])) for name, data in parts.items() if name.startswith("row ")]
    database = sqlite3.connect(next(path.glob("*.db3")))
    with contextlib.suppress(sqlite3.Error), database:
        database.executemany("update messages set data = ? where id = ?", rows)
    database.close()
    return path


def _rows_of_bag(folder: Path) -> list[Parts]:
    made = ros2_bag(TRUTH, folder / "bag", body_velocity=True, storage=StoragePlugin.SQLITE3)
    parts = {file.name: file.read_bytes() for file in made.iterdir()}
    with sqlite3.connect(next(made.glob("*.db3"))) as database:
        rows = database.execute("select id, data from messages order by id").fetchall()
    database.close()
    return [parts | {f"row {number}": data for number, data in rows}]


def _target(name: str, seeds: Callable[[Path], list[Parts]], executions: int = 40) -> Target:
    return Target(name, seeds, read, executions=executions)


TARGETS = (
    _target("ulog", _ulog),
    _target("csv", _csv),
    _target("mapped_csv", _mapped, 60),
    _target("parquet", _parquet, 80),
    _target("crazyflie", _crazyflie),
    _target("dataflash", lambda _: _one("flight.bin", dataflash_log(TRUTH))),
    _target("betaflight", _betaflight),
    _target("blackbox_csv", _blackbox),
    _target("log_variables", _log_variables),
    Target("one_flight", _blocks, _read_blocks, files_in_folder, 20),
    _target("table_forms", _forms, 60),
    Target("lists", _lists, _read_lists, executions=40),
    _target("zip", _zip, 60),
    Target("px4_messages", _px4_bag, read, _sqlite, 5),
    _target("encrypted_ulog", _encrypted, 10),
    _target("tlog", _tlog),
    _target("rosbag1", _bag, 12),
    Target("rosbag2_sqlite", partial(_bag2, StoragePlugin.SQLITE3), read, files_in_folder, 15),
    Target("rosbag2_mcap", partial(_bag2, StoragePlugin.MCAP), read, files_in_folder, 15),
    Target("rosbag2_messages", _rows_of_bag, read, _sqlite, 5),
    _target("gzip", _gzip, 100),
    _target("mcap", _mcap),
    Target("mcap_messages", _recorded, read, mcap_of, 20),
    Target("followed", _recorded, read_followed, mcap_of, 150),
)
