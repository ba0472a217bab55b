"""Worst cases of the nominal RTI step: periodic ticks at 100 Hz under SCHED_FIFO, memory locked, one core.

The vehicle flies the paper's Lemniscate on a plant with motor lag and rotor drag inside the same process; every tick
waits for its time, solves (feedback), then prepares. Reported: how late the tick woke, and how long its halves took.

    python benchmarks/rti_jitter.py [--seconds 60] [--rate 100]
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np
from provenance import write_result

from dynamics.model import build_model
from dynamics.references import named_reference
from dynamics.vehicle import EffectUse
from dynamics.vehicle_file import read_vehicle
from runtime.controller import Controller, ControllerOptions
from runtime.realtime import lock_memory, prepare_interpreter, schedule_thread
from runtime.rti.solver import RtiSolver
from vehicles import FOLDER


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--rate", type=float, default=100.0)
    arguments = parser.parse_args()
    vehicle = read_vehicle(Path(FOLDER) / "arpl_250g.toml")
    period = 1 / arguments.rate
    controller = Controller.build(vehicle, ControllerOptions(period=period, delay=0.0))
    plant_model = build_model(vehicle, effects=[EffectUse("motor_lag"), EffectUse("rotor_drag")])
    plant = RtiSolver(plant_model, controller.options.problem)
    reference = named_reference("Lemniscate", vehicle)
    truth = plant_model.initial_state(reference.states(np.array([0.0]))[0])
    controller.reset(truth[:13], 0.0)
    prepare_interpreter()
    refused = [text for text in (lock_memory(), *schedule_thread(50, 0)) if text]
    late, halves = [], []
    start = time.monotonic() + 0.05
    for tick in range(int(arguments.seconds * arguments.rate)):
        due = start + tick * period
        time.sleep(max(0.0, due - time.monotonic()))
        began = time.monotonic()
        state = controller.compensate(truth[:13], tick * period, tick * period)
        command = controller.feedback(state, tick * period)
        answered = time.monotonic()
        times = controller.node_times((tick * period) % reference.duration)
        controller.prepare(reference.states(times), reference.inputs(times[:-1]))
        ended = time.monotonic()
        truth = plant.propagate(truth, command.rotor_speed, period).copy()
        late.append(began - due)
        halves.append((answered - began, ended - answered, ended - began))
    microseconds = 1e6 * np.column_stack([late, halves])
    rows = ["| | median us | p99 us | p99.9 us | worst us |", "| --- | --- | --- | --- | --- |"]
    for name, values in zip(("woke late by", "feedback half", "preparation half", "step"), microseconds.T, strict=True):
        marks = " | ".join(f"{np.percentile(values, share):.0f}" for share in (50, 99, 99.9, 100))
        rows.append(f"| {name} | {marks} |")
    rows += ["", f"{len(late)} ticks at {arguments.rate:g} Hz. Real time: {'; '.join(refused) or 'granted'}."]
    write_result("rti_jitter", "Nominal RTI step under SCHED_FIFO", "\n".join(rows))


if __name__ == "__main__":
    main()
