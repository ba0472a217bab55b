"""The kernel of learned models: time of a real-time iteration, its parts, its share of the core's peak, its growth.

Trains PI-TCN and PI-MLP on a simulated quadrotor with motor lag (40 ms) and drag (`network_worker.py`), flies them and
the nominal model along a lemniscate in lockstep, and times every iteration of these flights on one core.

    python benchmarks/rti_network.py [--networks FOLDER] [--steps 8000]
"""

from __future__ import annotations

import argparse
import ctypes
import dataclasses
import json
import os
import subprocess
import sys
import time
from pathlib import Path

import matplotlib as mpl
import msgspec
import numpy as np
import onnxruntime
import torch
from provenance import RESULTS, write_result
from rti_flight import NETWORKS, PERIODS, STEPS, fly, networks, solver_for, unlimited

from dynamics.codegen import build_library
from dynamics.model import build_model
from export.network import Network
from export.onnx_file import onnx_model
from export.trained import ExportedModel, exported, read_model
from runtime.rti.problem import Problem
from runtime.rti.processor import PROCESSORS, Processor, native_processor
from runtime.rti.solver import RtiSolver
from training.checkpoint import TrainedModel, load
from training.config import ModelConfig
from training.networks import build_network

ROOT = Path(__file__).parents[1]
ACADOS = ROOT / ".venv-acados" / "lib"


def measure(folder: Path) -> dict[str, object]:
    """Everything that depends on the BLASFEO in use: iterations by instruction set, calm and saturated."""
    model, found = read_model(folder / "pi_tcn.pt"), {}
    for processor in [known for known in PROCESSORS.values() if known.runs_here]:
        solver = solver_for(model, processor)
        calm = [fly(solver, period)[1] for period in PERIODS.values() for _ in range(2)]
        runs = [fly(solver, 3.5, jumps=0.6) for _ in range(3)]
        hard, iterations = np.min([times for _, times, _ in runs], axis=0), runs[0][2]  # same ticks, least disturbed
        busy = hard[iterations > 0]
        found[processor.name] = {
            "median": np.median(np.concatenate(calm), axis=0).tolist(),
            "tenth": np.percentile(np.concatenate(calm), 10, axis=0).tolist(),
            "saturated": np.sum(busy[:, 3:5], axis=1).tolist(),
            "iterations": int(iterations.max()),
        }
    return found


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


def operations(network: Network, solver: RtiSolver, lanes: int) -> float:
    """Float operations of the iteration that was prepared last; tangents count with the columns that fill vectors."""
    columns = [*solver.history]
    state = solver.states[0].copy()
    substeps = round(solver.problem.node / network.dt)
    steps = solver.problem.nodes * substeps
    for s in range(steps):
        speed = solver.inputs[s // substeps]
        columns.append(np.concatenate([state, speed]))
        solver.history[:] = columns[-1 - len(solver.history) : -1]
        state = solver.propagate(state, speed, network.dt).copy()
    solver.history[:] = columns[: len(solver.history)]
    active, hidden = _active(network, np.array(columns))
    features = network.features - 4
    total = 0.0
    for s in range(steps):
        width = -(-(10 + 4 * (s // substeps + 1)) // lanes) * lanes
        t = s + network.receptive_field - 1
        for layer, convolution in enumerate(network.convolutions):
            out = active[layer][t]
            for tap in range(convolution.weight.shape[2]):
                if s >= tap * convolution.dilation:
                    given = features if layer == 0 else active[layer - 1][t - tap * convolution.dilation]
                    total += out * given * width
        total += (6 * active[-1][t] + (24 if network.outputs == "body" else 0) + 41 + 33) * width
        total += sum(6 * hidden[i][s] * dense.weight.shape[1] for i, dense in enumerate(network.perceptron[:-1]))
        total += sum(layer.weight.size for _, layer in network.layers)
    for j in range(solver.problem.nodes):
        width = -(-(10 + 4 * (j + 1)) // lanes) * lanes
        total += (solver.problem.nodes - j) * 13 * 4 * width
    return 2 * total


def _active(network: Network, columns: np.ndarray) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Numbers of active entries: of each convolution at every column, of each hidden layer at every substep."""
    from export.symbolic import features_function

    function = features_function(network)
    values = np.array([np.array(function(column)).ravel() for column in columns])
    counts, first = [], 0
    for layer in network.convolutions:
        first += layer.reach
        taps, rows = layer.weight.shape[2], np.zeros((len(values), len(layer.bias)))
        for t in range(first, len(values)):
            seen = [layer.weight[:, :, k] @ values[t - (taps - 1 - k) * layer.dilation] for k in range(taps)]
            rows[t] = np.maximum(0, sum(seen) + layer.bias)
        values = rows
        counts.append((values > 0).sum(axis=1))
    hidden, value = [], values[network.receptive_field - 1 :]
    for dense in network.perceptron[:-1]:
        value = np.maximum(0, value @ dense.weight.T + dense.bias)
        hidden.append((value > 0).sum(axis=1))
    return counts, hidden


def inference(model: ExportedModel) -> tuple[float, float]:
    """Seconds of one streamed column in the kernel, and of one window in ONNX Runtime; medians of alternating runs."""
    solver = solver_for(model, native_processor())
    rng = np.random.default_rng(0)
    hover = np.array([*[0.0] * 6, 1.0, *[0.0] * 6, *[model.vehicle.hover_speed] * 4])
    columns = np.ascontiguousarray(hover + 0.01 * rng.normal(size=(5000, 17)))
    found = np.zeros((5000, 6))
    code, pointer = solver._code, ctypes.c_void_p
    code.rti_stream.argtypes = (pointer, pointer, ctypes.c_int, pointer)
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    session = onnxruntime.InferenceSession(onnx_model(model, {}).SerializeToString(), options)
    window = {"history": np.ascontiguousarray(columns[: model.history].T[None]).astype(np.float32)}
    streamed, windowed = [], []
    for _ in range(30):
        start = time.perf_counter()
        code.rti_stream(solver._handle, columns.ctypes.data, 5000, found.ctypes.data)
        streamed.append((time.perf_counter() - start) / 5000)
        start = time.perf_counter()
        for _ in range(200):
            session.run(None, window)
        windowed.append((time.perf_counter() - start) / 200)
    return float(np.median(streamed)), float(np.median(windowed))


def growth(trained: TrainedModel) -> dict[str, list[tuple[int, float]]]:
    """Median seconds of an iteration against N, T and width, with random weights."""
    torch.manual_seed(0)
    config = trained.config
    found: dict[str, list[tuple[int, float]]] = {"N": [], "T": [], "channels": []}
    for nodes in (10, 20, 30, 40):
        found["N"].append((nodes, _step(trained, config, Problem(nodes=nodes, horizon=0.05 * nodes))))
    for history, kernel, dilations in (
        (4, 2, (1, 1, 1)),
        (10, 3, (1, 1, 1, 1)),
        (20, 3, (1, 2, 2, 4)),
        (40, 3, (1, 2, 4, 8)),
    ):
        changed = msgspec.structs.replace(config, history=history, kernel=kernel, dilations=dilations)
        found["T"].append((history, _step(trained, changed, Problem())))
    for channels in (8, 16, 32, 64):
        changed = msgspec.structs.replace(config, channels=channels)
        found["channels"].append((channels, _step(trained, changed, Problem())))
    return found


def _step(trained: TrainedModel, config: ModelConfig, problem: Problem) -> float:
    model = exported(dataclasses.replace(trained, config=config, networks=(build_network(config).eval(),)))
    solver = solver_for(model, native_processor(), problem)
    hover = np.array([0.0, 0.0, 1.0, *[0.0] * 3, 1.0, *[0.0] * 6])
    solver.reset(hover)
    solver.state_reference[:], solver.input_reference[:] = hover, model.vehicle.hover_speed
    solver.history[:] = [*hover, *[model.vehicle.hover_speed] * 4]
    times = []
    for _ in range(300):
        solver.prepare(hover)
        times.append(solver.report.prepare_seconds)
    return float(np.median(times))


def plot(found: dict[str, list[tuple[int, float]]]) -> None:
    mpl.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 3, figsize=(10, 3.2), sharey=True)
    for axis, (name, points) in zip(axes, found.items(), strict=True):
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


def timing(measured: dict[str, dict[str, dict]]) -> list[str]:
    names = "roll-out | tangents | Hessian, factor | preparation | feedback | step | fastest tenth"
    rows = [f"| instructions, BLASFEO | {names} | saturated, median | worst |", "| --- " * 10 + "|"]
    for build, by_name in measured.items():
        for name, found in by_name.items():
            median, tenth = 1e6 * np.array(found["median"]), 1e6 * np.array(found["tenth"])
            busy = 1e6 * np.array(found["saturated"])
            cells = [f"{value:.0f}" for value in (*median, median[3] + median[4], tenth[3] + tenth[4])]
            worst = (
                f"{np.median(busy):.0f} | {busy.max():.0f} ({found['iterations']} QP iterations)"
                if busy.size
                else "- | -"
            )
            rows.append(f"| {name}, {build} | {' | '.join(cells)} | {worst} |")
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--networks", type=Path, default=NETWORKS)
    parser.add_argument("--steps", type=int, default=STEPS)
    parser.add_argument("--measure", type=Path, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    if arguments.measure is not None:
        print(json.dumps(measure(arguments.measure)))
        return
    folder = networks(arguments.networks, arguments.steps)
    measured = {}
    builds: dict[str, Path | None] = {"CasADi's (generic)": None}
    if faster := list(ACADOS.glob("*/*/acados/install")):
        builds["acados' (Haswell)"] = faster[0]
    for name, install in builds.items():
        environment = {**os.environ, **({"ALULA_HPIPM": str(install)} if install else {})}
        command = [sys.executable, __file__, "--measure", str(folder)]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
        measured[name] = json.loads(done.stdout.splitlines()[-1])
    model, processor = read_model(folder / "pi_tcn.pt"), native_processor()
    assert model.network is not None
    solver = solver_for(model, processor)
    fly(solver, 3.5)
    work, best = operations(model.network, solver, processor.vector // 4), peak(processor)
    fastest = min(sum(found[processor.name]["median"][3:5]) for found in measured.values())
    streamed, windowed = inference(model)
    found = growth(load(folder / "pi_tcn.pt"))
    plot(found)
    lines = [
        "PI-TCN (T = 20, receptive field 19, 16 channels, body frame), N = 20 nodes of 50 ms, exact history "
        "derivatives, floats; microseconds, medians over flights along a lemniscate, other work on the machine. "
        "Saturated: ticks whose QP had active bounds while the reference leapt by 0.6 m every 0.3 s, under SCHED_FIFO, "
        "each the least of three equal flights.", "",
        *timing(measured), "",
        f"An iteration takes {work / 1e6:.1f} MFLOP; this core's peak with {processor.name}, measured in the same run, "
        f"is {best / 1e9:.0f} GFLOP/s: the median step runs at {100 * work / best / fastest:.0f} % of it.", "",
        f"One streamed column: {1e6 * streamed:.2f} us; the same window in ONNX Runtime: {1e6 * windowed:.1f} us, "
        f"{windowed / streamed:.0f} times as long.", "",
        "Closed loop in lockstep, rotor speeds given at 100 Hz to a plant with 40 ms of motor lag and drag:", "",
        *closed_loop(folder), "",
        "Growth of the preparation: " + "; ".join(
            f"{name} " + ", ".join(f"{size}: {1e6 * seconds:.0f} us" for size, seconds in points)
            for name, points in found.items()
        ) + ".", "", "![growth](rti_network.png)",
    ]  # fmt: skip
    write_result("rti_network", "The kernel of learned models, one core", "\n".join(lines))


if __name__ == "__main__":
    main()
