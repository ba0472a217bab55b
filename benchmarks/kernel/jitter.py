"""Worst cases of the RTI step: periodic ticks under SCHED_FIFO, memory locked, one core.

The vehicle flies the paper's Lemniscate on a plant with motor lag and drag inside the same process; every tick waits
for its time, solves (feedback), then prepares. Reported: how late the tick woke, and how long its halves took. A tick
that was not done when the next was due is a miss: of our making when the thread itself worked for longer than a period,
else the scheduler's (it woke the thread late, or took the processor away). A virtual machine's host takes processors
away unseen, and what it took counts as work: so the same number of ticks is counted with a loop in the step's place
that does nothing, as long as the median step.

    python -m benchmarks kernel jitter                                          the physical model, 100 Hz for a minute
    python -m benchmarks kernel jitter --learned --rate 500 --seconds 20        PI-TCN in its kernel
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import msgspec
import numpy as np

from benchmarks.kernel.flight import NETWORKS, networks
from benchmarks.kernel.network_worker import LAG_AND_DRAG
from benchmarks.measurement import Page, options_of
from dynamics.model import build_model
from dynamics.references import Reference, named_reference
from dynamics.vehicle import Vehicle
from dynamics.vehicle_file import read_vehicle
from export.bundle import ExportOptions, export_bundle
from export.trained import read_model
from runtime.control.bundle import read_bundle
from runtime.control.controller import Controller, ControllerOptions
from runtime.control.rti.problem import Problem
from runtime.control.rti.processor import native_processor
from runtime.control.rti.solver import RtiSolver
from runtime.realtime import lock_memory, prepare_interpreter, schedule_thread
from vehicles import FOLDER


def learned_controller(period: float, folder: Path) -> Controller:
    """PI-TCN's, from a bundle as `alula export` writes it."""
    model = read_model(networks(NETWORKS) / "pi_tcn.pt")
    exported = export_bundle(model, folder / "bundle", ExportOptions(Problem(), native_processor(), windows=50))
    bundle = read_bundle(exported.folder)
    return Controller.from_bundle(bundle, options(bundle.vehicle, period))


def options(vehicle: Vehicle, period: float) -> ControllerOptions:
    return msgspec.structs.replace(ControllerOptions.for_vehicle(vehicle, period=period), delay=0.0)


def fly(controller: Controller, reference: Reference, period: float, ticks: int) -> dict[str, np.ndarray]:
    """Seconds (ticks,) by name, of every tick, and the solver's status."""
    plant_model = build_model(controller.model.vehicle, effects=LAG_AND_DRAG)
    plant = RtiSolver(plant_model, controller.options.problem)
    truth = plant_model.initial_state(reference.states(np.array([0.0]))[0])
    controller.reset(truth[:13], 0.0)
    rows = np.zeros((ticks, 6))
    start = time.monotonic() + 0.05
    for tick in range(ticks):
        due = start + tick * period
        time.sleep(max(0.0, due - time.monotonic()))
        began, worked = time.monotonic(), time.thread_time()
        state = controller.compensate(truth[:13], tick * period, tick * period)
        command = controller.feedback(state, tick * period)
        answered = time.monotonic()
        times = controller.node_times((tick * period) % reference.duration)
        controller.prepare(reference.states(times), reference.inputs(times[:-1]))
        ended = time.monotonic()
        own = time.thread_time() - worked
        rows[tick] = (began - due, answered - began, ended - answered, ended - began, own, command.status)
        truth = plant.propagate(truth, command.rotor_speed, period).copy()
    names = ("woke late by", "feedback half", "preparation half", "step", "processor time of the step", "status")
    return dict(zip(names, rows.T, strict=True))


def idle(median: float, period: float, ticks: int) -> int:
    """How many of so many ticks are not done in time although a loop of `median` seconds is all they do."""
    rounds, began = 100_000, time.monotonic()
    _count(rounds)
    rounds = round(rounds * median / (time.monotonic() - began))
    start, missed = time.monotonic() + 0.05, 0
    for tick in range(ticks):
        due = start + tick * period
        time.sleep(max(0.0, due - time.monotonic()))
        _count(rounds)
        missed += time.monotonic() - due > period
    return missed


def _count(rounds: int) -> None:
    for _ in range(rounds):
        pass


def table(periods: dict[str, np.ndarray], period: float) -> list[str]:
    rows = ["| | median us | p99 us | p99.9 us | worst us |", "| --- | --- | --- | --- | --- |"]
    for name, values in periods.items():
        if name != "status":
            marks = " | ".join(f"{1e6 * np.percentile(values, share):.0f}" for share in (50, 99, 99.9, 100))
            rows.append(f"| {name} | {marks} |")
    missed = periods["woke late by"] + periods["step"] > period
    own = missed & (periods["processor time of the step"] > period)
    return [
        *rows,
        "",
        f"{missed.size} ticks at {1 / period:g} Hz: {own.sum()} misses of our making, "
        f"{(missed & ~own).sum()} by the scheduler, {np.count_nonzero(periods['status'])} unsolved.",
    ]


def jitter(words: Sequence[str]) -> Page:
    """The measurement's page."""
    parser = options_of(__doc__)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--rate", type=float, default=100.0)
    parser.add_argument("--learned", action="store_true", help="PI-TCN instead of the physical model")
    arguments = parser.parse_args(words)
    period = 1 / arguments.rate
    vehicle = read_vehicle(Path(FOLDER) / "arpl_250g.toml")
    with tempfile.TemporaryDirectory() as folder:
        if arguments.learned:
            controller = learned_controller(period, Path(folder))
        else:
            controller = Controller.build(vehicle, options(vehicle, period))
        reference = named_reference("Lemniscate", vehicle)
        fly(controller, reference, period, 50)
        prepare_interpreter()
        refused = [text for text in (lock_memory(), *schedule_thread(50, 0)) if text]
        ticks = int(arguments.seconds * arguments.rate)
        periods = fly(controller, reference, period, ticks)
        missed = idle(float(np.median(periods["step"])), period, ticks)
    idle_loop = (
        f"With a loop of the median step's length, which does nothing, in its place: {missed} misses of {ticks}."
    )
    body = [*table(periods, period), "", idle_loop, "", f"Real time: {'; '.join(refused) or 'granted'}."]
    name, kind = ("rti_jitter_network", "PI-TCN's") if arguments.learned else ("rti_jitter", "Nominal")
    return Page(name, f"{kind} RTI step under SCHED_FIFO", "\n".join(body))
