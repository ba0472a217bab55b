"""Writes the small copies in this folder: the first seconds of each input, in the format that it has.

Needs the inputs whole, which are too large to be kept here:
    PYTHONPATH=. python tests/data/field/cut.py FOLDER_OF_WHOLE_INPUTS
"""

from __future__ import annotations

import gzip
import io
import struct
import sys
import zipfile
from pathlib import Path

from mcap.reader import make_reader
from mcap.writer import Writer

HERE = Path(__file__).parent
SECONDS = 5.5  # inspection wants 5 s of free flight
HOLDING_OUT = 10.0  # the same for a comparison, which holds a part out
TABLES = {  # name to rows a second
    "02_erpm_pole_pairs/electrical_1": 100.0,
    "02_erpm_pole_pairs/ten_times_low_1": 100.0,
    "05_mocap_axes/motive_yup_mm_3": 100.0,
    "05_mocap_axes/zup_correct_mm_3": 100.0,
    "05_mocap_axes/zup_sign_flips_mm_3": 100.0,
    "07_blackbox_csv/LOG00001.01": 100.0,
    "14_board_turned/drag_acc90_1": 100.0,
    "14_board_turned/imu45_1": 100.0,
    "16_bursty_mocap_stamps/bursty_1": 200.0,
    "17_spreadsheet_csv/excel_de": 100.0,
    "17_spreadsheet_csv/milliseconds_as_t": 100.0,
    "17_spreadsheet_csv/sec_nsec": 100.0,
    "22_cells_with_lists/pandas_lists_3": 50.0,
}
ULOGS = (
    "01_ulog_outputs_instance_2/motors_on_instance_0", "01_ulog_outputs_instance_2/only_instance_2",
    "20_ulog_dshot_outputs/px4_1.13_dshot_3", "20_ulog_dshot_outputs/px4_1.13_pwm_3",
)  # fmt: skip
DATAFLASH = ("aux_9_to_12_1", "copter_3.4_no_servo_functions_3", "main_1_to_4_1", "oneshot125_3")
BAGS = ("03_ros2_px4_msgs/rosbag2_3", "04_two_clocks_bag/boot_clock_3", "04_two_clocks_bag/same_clock_3")
AS_THEY_ARE = (
    "02_erpm_pole_pairs/vehicle.toml", "05_mocap_axes/mapping.toml", "05_mocap_axes/mapping_metres.toml",
    "05_mocap_axes/mapping_w_first.toml", "22_cells_with_lists/mapping.toml",
    "06_ulog_containers_and_topics/encrypted.ulge", "13_own_network/residual.onnx", "13_own_network/scripted.pt",
    "13_own_network/state_dict.pt",
)  # fmt: skip
PACKED = "06_ulog_containers_and_topics/log_12_2026-4-1.ulg.zip"


def main() -> None:
    """Writes the copies beside this file."""
    whole = Path(sys.argv[1])
    for name, rate in TABLES.items():
        lines = (whole / f"{name}.csv").read_bytes().splitlines(keepends=True)
        write(
            f"{name}.csv.gz", b"".join(lines[: 1 + round((HOLDING_OUT if name.startswith("02") else SECONDS) * rate)])
        )
    for name in ULOGS:
        write(f"{name}.ulg.gz", cut_ulog(gzip.decompress((whole / f"{name}.ulg.gz").read_bytes())))
    for name in (f"09_ardupilot_aux_motors/{name}.bin.gz" for name in DATAFLASH):
        write(name, cut_dataflash(gzip.decompress((whole / name).read_bytes())))
    for name in BAGS:
        write(f"{name}.mcap", cut_bag((whole / name / f"{Path(name).name}.mcap").read_bytes()))
    for name in AS_THEY_ARE:
        write(name, (whole / name).read_bytes())
    packed = io.BytesIO()
    with zipfile.ZipFile(whole / PACKED) as archive, zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as cut:
        for member in archive.infolist():
            data = archive.read(member)
            kept = cut_ulog(data) if member.filename.endswith(".ulg") else data
            cut.writestr(zipfile.ZipInfo(member.filename), kept, zipfile.ZIP_DEFLATED)
    write(PACKED, packed.getvalue())


def write(name: str, data: bytes) -> None:
    """Write a file below this folder, packed where its name says so."""
    path = HERE / name
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(gzip.compress(data, 9, mtime=0) if name.endswith(".gz") else data)


def cut_ulog(data: bytes) -> bytes:
    """The ULog with the data messages of its first seconds."""
    kept, place, first = [data[:16]], 16, None
    while place + 3 <= len(data):
        size, kind = struct.unpack_from("<HB", data, place)
        message = data[place : place + 3 + size]
        place += len(message)
        if kind == ord("D"):
            stamp = struct.unpack_from("<Q", message, 5)[0]
            first = stamp if first is None else first
            if stamp > first + SECONDS * 1e6:
                continue
        kept.append(message)
    return b"".join(kept)


def cut_dataflash(data: bytes) -> bytes:
    """The DataFlash log with the messages of its first seconds."""
    formats: dict[int, tuple[int, str]] = {128: (89, "BBnNZ")}
    kept, place, first = [], 0, None
    while place + 3 <= len(data):
        number = data[place + 2]
        size, fields = formats[number]
        message = data[place : place + size]
        place += size
        if number == 128:
            defined, length = message[3], message[4]
            formats[defined] = (length, message[9:25].split(b"\0")[0].decode())
        elif fields.startswith("Q"):  # TimeUS
            stamp = struct.unpack_from("<Q", message, 3)[0]
            first = stamp if first is None and stamp else first
            if first is not None and stamp > first + SECONDS * 1e6:
                continue
        kept.append(message)
    return b"".join(kept)


def cut_bag(data: bytes) -> bytes:
    """The MCAP file of a bag with the messages of its first seconds."""
    written = io.BytesIO()
    writer, schemas, channels, first = Writer(written), {}, {}, None
    writer.start("ros2")
    for schema, channel, message in make_reader(io.BytesIO(data)).iter_messages():
        first = message.log_time if first is None else first
        if message.log_time > first + SECONDS * 1e9 or schema is None:
            continue
        if channel.topic not in channels:
            number = schemas.setdefault(schema.name, writer.register_schema(schema.name, schema.encoding, schema.data))
            channels[channel.topic] = writer.register_channel(
                channel.topic, channel.message_encoding, number, dict(channel.metadata)
            )
        writer.add_message(channels[channel.topic], message.log_time, message.data, message.publish_time)
    writer.finish()
    return written.getvalue()


if __name__ == "__main__":
    main()
