"""Cost of the mock flight controller: its share of a core in real time, and its factor in lockstep.

Real time: the process on UDP with PX4's default streams on both links, idle and flown at 100 Hz with ODOMETRY and
ESC_STATUS at 100 Hz. Lockstep: the same objects in this process, a SET_ATTITUDE_TARGET in and all frames out every
10 ms of simulated time.

    python -m benchmarks.mock_load [--seconds S]
"""

from __future__ import annotations

import argparse
import os
import socket
import time
from pathlib import Path

from benchmarks.provenance import write_result
from simulation.mock_process import mock_process
from sitl_mock.mock import MockOptions, build_autopilot
from sitl_mock.wire.dialect import mavlink
from vehicles import FOLDER

PERIOD = 0.010  # s
ODOMETRY, ESC_STATUS = 331, 291
PACKER = mavlink.MAVLink(None, srcSystem=1, srcComponent=191)


def command(number: int, *parameters: float) -> bytes:
    seven = [*parameters, *[0.0] * (7 - len(parameters))]
    return bytes(mavlink.MAVLink_command_long_message(1, 1, number, 0, *seven).pack(PACKER))


def setpoint(thrust: float) -> bytes:
    return bytes(mavlink.MAVLink_set_attitude_target_message(0, 1, 1, 7, [1, 0, 0, 0], 0, 0, 0, thrust).pack(PACKER))


def processor_time(process: int) -> float:
    fields = Path(f"/proc/{process}/stat").read_text(encoding="ascii").rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def share_of_a_core(seconds: float, flown: bool) -> float:
    """Processor time of the mock's process over wall time."""
    with mock_process() as mock, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as end:
        end.bind(("127.0.0.1", mock.port))
        end.settimeout(5.0)
        _, address = end.recvfrom(4096)
        frames = [command(511, ODOMETRY, 1e4), command(511, ESC_STATUS, 1e4), command(176, 1, 6), setpoint(0.0)]
        for frame in (*frames, command(400, 1)) if flown else ():
            end.sendto(frame, address)
        before, start = processor_time(mock.process.pid), time.monotonic()
        number = 0
        while time.monotonic() - start < seconds:
            number += 1
            if flown:
                end.sendto(setpoint(0.3), address)
            time.sleep(max(0.0, start + number * PERIOD - time.monotonic()))
        return (processor_time(mock.process.pid) - before) / (time.monotonic() - start)


def lockstep_factor(name: str, seconds: float) -> tuple[float, float]:
    """Simulated time over wall time and over processor time."""
    mock = build_autopilot(MockOptions(FOLDER / f"{name}.toml"))
    link = mock.add_link("bench", "onboard")
    link.punctual = True
    for frame in (command(511, ODOMETRY, 1e4), setpoint(0.0), command(176, 1, 6), command(400, 1)):
        mock.receive(link, "bench", frame)
    hover = mock.parameters["MPC_THR_HOVER"]
    wall, processor = time.perf_counter(), time.thread_time()
    for _ in range(round(seconds / PERIOD)):
        mock.receive(link, "bench", setpoint(hover))
        mock.advance(PERIOD)
        link.take(mock.time)
    return seconds / (time.perf_counter() - wall), seconds / (time.thread_time() - processor)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=20.0, help="wall time, or simulated time, of each row")
    seconds = parser.parse_args().seconds
    idle, flown = share_of_a_core(seconds, flown=False), share_of_a_core(seconds, flown=True)
    lines = [
        "| real time | share of a core |",
        "| --- | --- |",
        f"| idle, default streams | {100 * idle:.1f} % |",
        f"| flown at 100 Hz | {100 * flown:.1f} % |",
        "",
        "| lockstep, 100 Hz, default streams | times real time (wall) | (processor time) |",
        "| --- | --- | --- |",
    ]
    for name in ("arpl_250g", "px4_sih"):
        wall, processor = lockstep_factor(name, seconds)
        lines.append(f"| {name} | {wall:.1f} | {processor:.1f} |")
    text = f"{seconds:g} s for each row. The machine was shared: load average {os.getloadavg()[0]:.1f} on "
    text += f"{os.cpu_count()} cores, which lengthens wall times.\n\n"
    write_result("mock_load", "Load of the mock flight controller", text + "\n".join(lines))


if __name__ == "__main__":
    main()
