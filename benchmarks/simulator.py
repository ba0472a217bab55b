"""Speed of the mock: its process, its vehicle, and plant and controller in lockstep."""

from __future__ import annotations

import os
import socket
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from benchmarks.measurement import Page, options_of
from dynamics.references import named_reference
from dynamics.vehicle import EffectUse, Vehicle
from dynamics.vehicle_file import read_vehicle
from runtime.control.controller import Controller
from simulation.lockstep import fly_reference
from simulation.mock_process import mock_process
from sitl_mock.mock import MockOptions, build_autopilot
from sitl_mock.vehicle.vehicle import SimulatedVehicle
from sitl_mock.vehicle.vehicle_interface import ControlSetpoint
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


def load(words: Sequence[str]) -> Page:
    """Cost of the mock flight controller: its share of a core in real time, and its factor in lockstep.

    Real time: the process on UDP with PX4's default streams on both links, idle and flown at 100 Hz with ODOMETRY and
    ESC_STATUS at 100 Hz. Lockstep: the same objects in this process, a SET_ATTITUDE_TARGET in and all frames out every
    10 ms of simulated time.

        python -m benchmarks simulator load [--seconds S]
    """
    parser = options_of(load.__doc__)
    parser.add_argument("--seconds", type=float, default=20.0, help="wall time, or simulated time, of each row")
    seconds = parser.parse_args(words).seconds
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
    return Page("mock_load", "Load of the mock flight controller", text + "\n".join(lines))


EVERY_EFFECT = [
    EffectUse("rotor_drag"),
    EffectUse("parasitic_drag"),
    EffectUse("blade_flapping"),
    EffectUse("wind"),
    EffectUse("gust"),
    EffectUse("ground_effect"),
    EffectUse("axial_inflow"),
    EffectUse("translational_lift"),
    EffectUse("centre_of_mass"),
    EffectUse("battery_sag"),
]


def hovering(vehicle: Vehicle, effects: list[EffectUse]) -> SimulatedVehicle:
    mock = SimulatedVehicle(vehicle, effects=effects)
    mock.advance(ControlSetpoint("hold", position_world=np.array([0.0, 0.0, 20.0])), True, 15.0)
    return mock


def by_rates(mock: SimulatedVehicle, number: int) -> None:
    rate = np.array([0.1 * np.sin(number / 20), 0.1 * np.cos(number / 20), 0.0])
    mock.advance(ControlSetpoint("rates", rate_body=rate, thrust=mock.tuning.hover_thrust), True, PERIOD)
    read(mock)


def in_passes(mock: SimulatedVehicle, number: int) -> None:
    setpoint = ControlSetpoint("rates", rate_body=np.zeros(3), thrust=mock.tuning.hover_thrust)
    for duration in (0.004, 0.004, 0.002):
        mock.advance(setpoint, True, duration)
    read(mock)


def by_position(mock: SimulatedVehicle, number: int) -> None:
    mock.advance(ControlSetpoint("hold"), True, PERIOD)
    read(mock)


def read(mock: SimulatedVehicle) -> None:
    _ = mock.estimate, mock.imu, mock.rotor_speed


def measure(mock: SimulatedVehicle, fly: Callable[[SimulatedVehicle, int], None], periods: int) -> list[float]:
    """For one period: median and 99th percentile of the wall time, and mean processor time, s."""
    taken, used = [], time.thread_time()
    for number in range(periods):
        start = time.perf_counter()
        fly(mock, number)
        taken.append(time.perf_counter() - start)
    processor = (time.thread_time() - used) / periods
    return [float(np.median(taken)), float(np.percentile(taken, 99)), processor]


def speed(words: Sequence[str]) -> Page:
    """How much faster than real time the mock's vehicle flies: plant, inner loop and sensors on one core.

    A setpoint a control period of 10 ms, as a controller at 100 Hz sends it, and the estimate, an inertial sample and
    the rotor speeds read back after each; also in the 4 ms passes in which the mock flight controller advances it.

        python -m benchmarks simulator speed [--seconds S]
    """
    parser = options_of(speed.__doc__)
    parser.add_argument("--seconds", type=float, default=30.0, help="simulated time for each row")
    periods = round(parser.parse_args(words).seconds / PERIOD)
    small, sih = (read_vehicle(FOLDER / f"{name}.toml") for name in ("arpl_250g", "px4_sih"))
    cases = [
        ("arpl_250g, body rates", small, [], by_rates),
        ("arpl_250g, body rates, 4 ms passes", small, [], in_passes),
        ("arpl_250g, ten hidden effects, body rates", small, EVERY_EFFECT, by_rates),
        ("px4_sih, body rates", sih, [], by_rates),
        ("arpl_250g, position hold", small, [], by_position),
    ]
    rows = [
        "| vehicle and setpoints | 10 ms take, median us | p99 us | processor time us | times real time |",
        "| --- | --- | --- | --- | --- |",
    ]
    for name, vehicle, effects, fly in cases:
        median, slowest, processor = measure(hovering(vehicle, effects), fly, periods)
        cells = [f"{1e6 * value:.1f}" for value in (median, slowest, processor)]
        rows.append(f"| {name} | {' | '.join(cells)} | {PERIOD / median:.0f} |")
    text = f"{periods} periods of 10 ms in each row, ten steps of 1 ms (RK4) each; one core, from Python. "
    text += f"The machine was shared: load average {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores.\n\n"
    return Page("mock_speed", "Speed of the mock's vehicle", text + "\n".join(rows))


NAMES = ("Ellipse_1", "WarpedEllipse_2", "Lemniscate", "TransposedParabola")


def lockstep(words: Sequence[str]) -> Page:
    """How much faster than real time plant and controller fly together in one process on one core.

    `simulation.lockstep.fly_reference` runs the flight logic and controller of `alula fly` at 100 Hz against the mock's
    vehicle (1 ms steps, inner loops, sensors, battery), without MAVLink. The climb to the start is in the time spent
    but not in the time simulated.

        python -m benchmarks simulator lockstep [--repeats 5]
    """
    parser = options_of(lockstep.__doc__)
    parser.add_argument("--repeats", type=int, default=5)
    repeats = parser.parse_args(words).repeats
    os.sched_setaffinity(0, {0})
    vehicle = read_vehicle(FOLDER / "arpl_250g.toml")
    fly_reference(vehicle, named_reference("circle:laps=1", vehicle), controller=Controller.build(vehicle))
    rows = ["| manoeuvre | simulated s | times real time, processor time | wall time |", "| --- " * 4 + "|"]
    for name in NAMES:
        reference = named_reference(name, vehicle)
        factors = []
        for repeat in range(repeats):
            controller = Controller.build(vehicle)
            spent, began = time.process_time(), time.perf_counter()
            flown = fly_reference(vehicle, reference, seed=repeat, controller=controller)
            spent, wall = time.process_time() - spent, time.perf_counter() - began
            if flown.aborted:
                raise SystemExit(f"{name} ended early: {flown.aborted}")
            factors.append((reference.duration / spent, reference.duration / wall))
        processor, wall_factor = np.median(factors, axis=0)
        rows.append(f"| {name} | {reference.duration:.1f} | {processor:.1f} | {wall_factor:.1f} |")
    load = os.getloadavg()[0]
    rows += ["", f"Medians of {repeats} runs, pinned to one core, load average {load:.1f}."]
    return Page("lockstep_speed", "Plant and controller in lockstep", "\n".join(rows))
