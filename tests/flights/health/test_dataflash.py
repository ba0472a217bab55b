"""ArduPilot's logs: vibration, errors by subsystem, modes and landings as its DataFlash messages have them."""

from __future__ import annotations

import struct
from pathlib import Path

import pytest

from flights.health import ardupilot, read_health
from flights.reading import read_log

FORMATS = {
    "PARM": (129, "QNf", "TimeUS,Name,Value"),
    "XKF1": (130, "QBffffff", "TimeUS,C,VN,VE,VD,PN,PE,PD"),
    "XKQ": (131, "QBffff", "TimeUS,C,Q1,Q2,Q3,Q4"),
    "IMU": (132, "QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ"),
    "RCOU": (133, "QHHHH", "TimeUS,C1,C2,C3,C4"),
    "VIBE": (134, "QBfffI", "TimeUS,IMU,VibeX,VibeY,VibeZ,Clip"),
    "ERR": (135, "QBB", "TimeUS,Subsys,ECode"),
    "EV": (136, "QB", "TimeUS,Id"),
    "MODE": (137, "QMBB", "TimeUS,Mode,ModeNum,Rsn"),
    "BAT": (138, "QBff", "TimeUS,Inst,Volt,Curr"),
    "ARM": (139, "QB", "TimeUS,ArmState"),
}
CODES = {"Q": "Q", "B": "B", "M": "B", "f": "f", "N": "16s", "H": "H", "I": "I"}
SECONDS, RATE = 30, 10


def record(name: str, *values: object) -> bytes:
    number, form, _ = FORMATS[name]
    return bytes([0xA3, 0x95, number]) + struct.pack("<" + "".join(CODES[letter] for letter in form), *values)


def log(*, vibration: float = 5.0, clips: int = 0, errors: tuple[tuple[float, int, int], ...] = ()) -> bytes:
    """A hover of 20 s at 5 m between take-off and landing, with given vibration and errors (s, subsystem, code)."""
    data = struct.pack("<BBBBB4s16s64s", 0xA3, 0x95, 128, 128, 89, b"FMT", b"BBnNZ", b"Type,Length,Name,Format,Columns")
    for name, (number, form, columns) in FORMATS.items():
        size = struct.calcsize("<" + "".join(CODES[letter] for letter in form)) + 3
        words = (name.encode(), form.encode(), columns.encode())
        data += struct.pack("<BBBBB4s16s64s", 0xA3, 0x95, 128, number, size, *words)
    parameters = {"FRAME_CLASS": 1.0, "FRAME_TYPE": 1.0, **{f"SERVO{n}_FUNCTION": 32.0 + n for n in range(1, 5)}}
    for name, value in parameters.items():
        data += record("PARM", 0, name.encode(), value)
    for step in range(SECONDS * RATE):
        t = step / RATE
        us = 5_000_000 + step * 1_000_000 // RATE
        height = 5.0 * min(1.0, max(0.0, min(t - 4.0, 27.0 - t)))
        if t == 1.0:
            data += record("ARM", us, 1) + record("EV", us, 10) + record("MODE", us, 5, 5, 1)
        if t == 4.0:
            data += record("EV", us, 28)
        if t == 20.0:
            data += record("MODE", us, 6, 6, 2)
        if t == 28.0:
            data += record("EV", us, 18) + record("EV", us, 11) + record("ARM", us, 0)
        for when, system, code in errors:
            if t == when:
                data += record("ERR", us, system, code)
        pulses = [1500] * 4 if 4.0 <= t < 28.0 else [1000] * 4
        data += record("XKF1", us, 0, 0.0, 0.0, 0.0, 0.0, 0.0, -height) + record("XKQ", us, 0, 1.0, 0.0, 0.0, 0.0)
        data += record("IMU", us, 0, 0.0, 0.0, 0.0, 0.0, 0.0, -9.81) + record("RCOU", us, *pulses)
        data += record("VIBE", us, 0, vibration, vibration, vibration, clips * step // (SECONDS * RATE))
        data += record("BAT", us, 0, 16.0, 10.0)
    return data


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "log.bin"


def test_a_healthy_flight_has_no_defect(path: Path) -> None:
    path.write_bytes(log())
    health = read_health(read_log(path))
    assert (health.first, health.defects) == ("", ())
    assert health.in_air == pytest.approx(24.0, abs=0.3)
    texts = [event.text for event in health.events]
    order = ["mode Loiter", "took off", "mode RTL", "landed"]
    assert [text for text in texts if text in order] == order


@pytest.mark.parametrize(("vibration", "level"), [(20.0, None), (40.0, "warning"), (70.0, "fault")])
def test_vibration_by_ardupilots_own_limits(path: Path, vibration: float, level: str | None) -> None:
    path.write_bytes(log(vibration=vibration))
    levels = {s.level for s in read_health(read_log(path)).statements if s.name == "vibration"}
    assert levels == ({level} if level else set())


def test_samples_at_the_accelerometers_limit_are_counted(path: Path) -> None:
    path.write_bytes(log(clips=400))
    (clipping,) = [s for s in read_health(read_log(path)).statements if s.name == "clipping"]
    assert (clipping.level, clipping.certainty) == ("fault", "seen")
    assert clipping.evidence.value == pytest.approx(400 * 24 / 30, rel=0.1)


@pytest.mark.parametrize(
    ("system", "name"), [(6, "reported_battery_failsafe"), (12, "reported_crash_check"), (17, "reported_EKF_failsafe")]
)
def test_an_error_comes_first_with_its_time(path: Path, system: int, name: str) -> None:
    path.write_bytes(log(errors=((15.0, system, 1),)))
    health = read_health(read_log(path))
    assert health.first == name
    assert health.defects[0].start == pytest.approx(15.0, abs=0.2)


def test_of_two_errors_the_earlier_one_comes_first(path: Path) -> None:
    path.write_bytes(log(errors=((12.0, 16, 2), (16.0, 12, 1))))
    health = read_health(read_log(path))
    assert health.sentences[0].index("variances") < health.sentences[0].index("crash check")


@pytest.mark.parametrize("cut", [0.3, 0.6, 0.9])
def test_a_log_that_is_cut_off_still_answers(path: Path, cut: float) -> None:
    data = log()
    path.write_bytes(data[: int(cut * len(data))])
    assert len(read_health(read_log(path)).sentences) == 2


def test_a_file_of_damaged_bytes_gives_no_channel(path: Path) -> None:
    path.write_bytes(log()[:200] + bytes(500))
    assert ardupilot.read(path, 5.0).vibration == ()
