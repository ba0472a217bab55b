"""The kernel of learned models: time of a real-time iteration, its parts, its share of the core's peak, its growth.

Trains PI-TCN and PI-MLP on a simulated quadrotor with motor lag (40 ms) and drag (`network_worker.py`), flies them and
the nominal model along a lemniscate in lockstep, and times every iteration of these flights on one core.

    python -m benchmarks kernel network [--networks FOLDER]      three minutes, six where it has to train
"""

from __future__ import annotations

import ctypes
import dataclasses
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import msgspec
import numpy as np
import onnxruntime
import torch

from benchmarks.kernel.flight import NETWORKS, PERIODS, STEPS, fly, networks, solver_for, unlimited
from benchmarks.measurement import Page, options_of
from benchmarks.provenance import RESULTS
from dynamics.codegen import build_library
from dynamics.model import build_model
from export.kernel import build_kernel, kernel_recipe
from export.onnx_file import onnx_model
from export.trained import ExportedModel, exported, read_model
from runtime.control.rti.problem import Problem
from runtime.control.rti.processor import PROCESSORS, Processor, native_processor
from runtime.control.rti.solver import RtiSolver
from training.checkpoint import TrainedModel, load
from training.config import ModelConfig
from training.networks import build_network


def measure(folder: Path) -> dict[str, dict[str, Any]]:
    """Iterations by instruction set, in turns, calm and saturated."""
    model, timings = read_model(folder / "pi_tcn.pt"), {}
    solvers = {name: solver_for(model, processor) for name, processor in PROCESSORS.items() if processor.runs_here}
    calm: dict[str, list] = {name: [] for name in solvers}
    hard: dict[str, list] = {name: [] for name in solvers}
    for _ in range(3):
        for name, solver in solvers.items():
            calm[name] += [fly(solver, period)[1] for period in PERIODS.values()]
            hard[name].append(fly(solver, PERIODS["5.1"], jumps=0.6))
    for name in solvers:
        best, iterations = (
            np.min([times for _, times, _ in hard[name]], axis=0),
            hard[name][0][2],
        )  # of the same ticks
        timings[name] = {
            "median": np.median(np.concatenate(calm[name]), axis=0).tolist(),
            "tenth": np.percentile(np.concatenate(calm[name]), 10, axis=0).tolist(),
            "saturated": np.sum(best[iterations > 0, 3:5], axis=1).tolist(),
            "iterations": int(iterations.max()),
        }
    return timings


PEAK = """
typedef float vector __attribute__((vector_size(VECTOR_BYTES)));
float peak(long rounds) {
    vector sum[12], factor = {0}, total = {0};
    for (int i = 0; i < 12; i++) sum[i] = factor + 1e-3f * (float)i;
    factor += 0.999f;
    for (long k = 0; k < rounds; k++)
        _Pragma("GCC unroll 12") for (int i = 0; i < 12; i++) sum[i] = sum[i] * factor + factor;
    for (int i = 0; i < 12; i++) total += sum[i];
    return total[0];
}
"""


def peak(processor: Processor) -> float:
    """Float operations a second of this core with such registers: the best of some rounds of fused multiply-adds."""
    flags = (*processor.compiler_flags, f"-DVECTOR_BYTES={processor.vector}")
    code = ctypes.CDLL(str(build_library({"peak.c": PEAK}, flags=flags, entry="peak.c")))
    code.peak.argtypes = (ctypes.c_long,)
    best = float("inf")
    for _ in range(40):
        start = time.perf_counter()
        code.peak(300_000)
        best = min(best, time.perf_counter() - start)
    return 300_000 * 12 * 2 * processor.vector / 4 / best


def operations(model: ExportedModel, processor: Processor) -> float:
    """Mean float operations of an iteration, as a kernel counts them along a lemniscate; tangents in whole vectors."""
    assert model.network is not None
    flight_model = unlimited(model).flight_model
    recipe = kernel_recipe(model.network, flight_model, Problem(), processor)
    counting = dataclasses.replace(recipe, flags=(*recipe.flags, "-DCOUNT_OPERATIONS"))
    library = build_kernel(counting)
    solver = RtiSolver(flight_model, Problem(), library)
    count = ctypes.CDLL(str(library)).rti_operations
    count.restype = ctypes.c_double
    ticks = sum(len(fly(solver, period)[1]) for period in PERIODS.values())
    return count() / ticks


def inference(model: ExportedModel) -> tuple[float, float]:
    """Seconds of one streamed column in the kernel, and of one window in ONNX Runtime; medians of alternating runs."""
    solver = solver_for(model, native_processor())
    rng = np.random.default_rng(0)
    hover = np.array([*[0.0] * 6, 1.0, *[0.0] * 6, *[model.vehicle.hover_speed] * 4])
    columns = np.ascontiguousarray(hover + 0.01 * rng.normal(size=(5000, 17)))
    timings = np.zeros((5000, 6))
    code, pointer = solver._code, ctypes.c_void_p
    code.rti_stream.argtypes = (pointer, pointer, ctypes.c_int, pointer)
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    session = onnxruntime.InferenceSession(onnx_model(model, {}).SerializeToString(), options)
    window = {"history": np.ascontiguousarray(columns[: model.history].T[None]).astype(np.float32)}
    streaming, windowed = [], []
    for _ in range(30):
        start = time.perf_counter()
        code.rti_stream(solver._handle, columns.ctypes.data, 5000, timings.ctypes.data)
        streaming.append((time.perf_counter() - start) / 5000)
        start = time.perf_counter()
        for _ in range(200):
            session.run(None, window)
        windowed.append((time.perf_counter() - start) / 200)
    return float(np.median(streaming)), float(np.median(windowed))


def growth(trained: TrainedModel) -> dict[str, list[tuple[int, float]]]:
    """Median seconds of a preparation against N, T and width, with random weights, all in turns."""
    torch.manual_seed(0)
    config = trained.config
    cases = [("N", nodes, config, Problem(nodes=nodes, horizon=0.05 * nodes)) for nodes in (10, 20, 30, 40)]
    for history, kernel, dilations in (
        (4, 2, (1, 1, 1)),
        (10, 3, (1, 1, 1, 1)),
        (20, 3, (1, 2, 2, 4)),
        (40, 3, (1, 2, 4, 8)),
    ):
        changed = msgspec.structs.replace(config, history=history, kernel=kernel, dilations=dilations)
        cases.append(("T", history, changed, Problem()))
    wider = ((channels, msgspec.structs.replace(config, channels=channels)) for channels in (8, 16, 32, 64))
    cases += [("channels", channels, changed, Problem()) for channels, changed in wider]
    solvers = [_hovering(trained, changed, problem) for _, _, changed, problem in cases]
    times: list[list[float]] = [[] for _ in cases]
    for _ in range(10):
        for solver, taken in zip(solvers, times, strict=True):
            for _ in range(30):
                solver.prepare(solver.state_reference[0])
                taken.append(solver.report.prepare_seconds)
    timings: dict[str, list[tuple[int, float]]] = {}
    for (name, size, _, _), taken in zip(cases, times, strict=True):
        timings.setdefault(name, []).append((size, float(np.median(taken))))
    return timings


def _hovering(trained: TrainedModel, config: ModelConfig, problem: Problem) -> RtiSolver:
    """A solver with hover in its history and as its reference."""
    model = exported(dataclasses.replace(trained, config=config, networks=(build_network(config).eval(),)))
    solver = solver_for(model, native_processor(), problem)
    hover = np.array([0.0, 0.0, 1.0, *[0.0] * 3, 1.0, *[0.0] * 6])
    solver.reset(hover)
    solver.state_reference[:], solver.input_reference[:] = hover, model.vehicle.hover_speed
    solver.history[:] = [*hover, *[model.vehicle.hover_speed] * 4]
    return solver


def plot(timings: dict[str, list[tuple[int, float]]]) -> None:
    mpl.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 3, figsize=(10, 3.2), sharey=True)
    for axis, (name, points) in zip(axes, timings.items(), strict=True):
        sizes, times = np.array(points).T
        axis.loglog(sizes, 1e6 * times, "o-", color="tab:blue", label="kernel")
        if name == "N":
            axis.loglog(sizes, 1e6 * times[0] * (sizes / sizes[0]) ** 2, "--", color="0.6", label="N squared")
            axis.legend(frameon=False)
        axis.set_xticks(sizes, [f"{size:.0f}" for size in sizes], minor=False)
        axis.minorticks_off()
        axis.set_xlabel({"N": "nodes N", "T": "history T", "channels": "channels"}[name])
    axes[0].set_ylabel("preparation, us")
    figure.tight_layout()
    figure.savefig(RESULTS / "rti_network.png", dpi=120)


def closed_loop(folder: Path) -> list[str]:
    rows = ["| model | " + " | ".join(f"RMSE cm at {speed} m/s" for speed in PERIODS) + " |", "| --- | --- | --- |"]
    vehicle = unlimited(read_model(folder / "pi_tcn.pt")).vehicle
    nominal = [fly(RtiSolver(build_model(vehicle, effects=()), Problem()), period)[0] for period in PERIODS.values()]
    rows.append(f"| nominal | {nominal[0]:.2f} | {nominal[1]:.2f} |")
    for kind in ("pi_mlp", "pi_tcn"):
        solver = solver_for(read_model(folder / f"{kind}.pt"), native_processor())
        flown = [fly(solver, period)[0] for period in PERIODS.values()]
        ratios = [f"{error:.2f} ({error / other:.2f} of nominal)" for error, other in zip(flown, nominal, strict=True)]
        rows.append(f"| {kind} | {ratios[0]} | {ratios[1]} |")
    return rows


def timing(measured: dict[str, dict[str, Any]]) -> list[str]:
    names = "roll-out | tangents | Hessian, factor | preparation | feedback | step | fastest tenth"
    rows = [f"| instructions | {names} | saturated, median | worst |", "| --- " * 10 + "|"]
    for name, timings in measured.items():
        median, tenth = 1e6 * np.array(timings["median"]), 1e6 * np.array(timings["tenth"])
        busy = 1e6 * np.array(timings["saturated"])
        cells = [f"{value:.0f}" for value in (*median, median[3] + median[4], tenth[3] + tenth[4])]
        worst = "- | -"
        if busy.size:
            worst = f"{np.median(busy):.0f} | {busy.max():.0f} ({timings['iterations']} QP iterations)"
        rows.append(f"| {name} | {' | '.join(cells)} | {worst} |")
    return rows


def network(words: Sequence[str]) -> Page:
    """The measurement's page."""
    parser = options_of(__doc__)
    parser.add_argument("--networks", type=Path, default=NETWORKS)
    parser.add_argument("--steps", type=int, default=STEPS)
    arguments = parser.parse_args(words)
    torch.set_num_threads(1)
    folder = networks(arguments.networks, arguments.steps)
    measured = measure(folder)
    model, processor = read_model(folder / "pi_tcn.pt"), native_processor()
    work, best = operations(model, processor), peak(processor)
    fastest = sum(measured[processor.name]["median"][3:5])
    streaming, windowed = inference(model)
    timings = growth(load(folder / "pi_tcn.pt"))
    if not (arguments.no_page or arguments.quick):
        plot(timings)
    lines = [
        "PI-TCN (T = 20, receptive field 19, 16 channels, body frame), N = 20 nodes of 50 ms, exact history "
        "derivatives, floats; microseconds, medians over flights along a lemniscate. "
        "Saturated: ticks whose QP had active bounds while the reference leapt by 0.6 m every 0.3 s, under SCHED_FIFO, "
        "each the least of three equal flights.", "",
        *timing(measured), "",
        f"An iteration takes {work / 1e6:.1f} MFLOP; this core's peak with {processor.name}, measured in the same run, "
        f"is {best / 1e9:.0f} GFLOP/s: the median step runs at {100 * work / best / fastest:.0f} % of it. The kernel "
        "counted its operations along the same flights: the network's, the tangents' and the Hessian's.", "",
        f"One streamed column: {1e6 * streaming:.2f} us; the same window in ONNX Runtime: {1e6 * windowed:.1f} us, "
        f"{windowed / streaming:.0f} times as long.", "",
        "Closed loop in lockstep, rotor speeds given at 100 Hz to a plant with 40 ms of motor lag and drag:", "",
        *closed_loop(folder), "",
        "Growth of the preparation, in turns, random weights: " + "; ".join(
            f"{name} " + ", ".join(f"{size}: {1e6 * seconds:.0f} us" for size, seconds in points)
            for name, points in timings.items()
        ) + ".", "", "![growth](rti_network.png)",
    ]  # fmt: skip
    return Page("rti_network", "The kernel of learned models, one core", "\n".join(lines))
