"""Time of one prediction by engine: torch's window, the streaming network, the ONNX file, C.

The C code of a network is the real-time kernel's, which takes column by column as in the controller's roll-out.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

import msgspec
import numpy as np
import onnxruntime
import torch

from dynamics.errors import RequestError
from export.onnx_file import onnx_model
from export.trained import exported
from training.checkpoint import TrainedModel
from training.data.labelled_rows import LabelledRows
from training.evaluation import PLANT, EvaluatedModel
from training.physics import BLOCK, RowModel
from training.run import one_thread
from training.streaming import Stream

REPEATS, WARM_UP = 300, 20
COLUMNS = 200  # a call of the kernel, so that the call itself does not count


class Inference(msgspec.Struct, frozen=True):
    """Seconds of one prediction: the median, and the 90th percentile."""

    model: str
    engine: str
    median: float
    slowest: float


def time_inference(judged: Sequence[EvaluatedModel]) -> tuple[tuple[Inference, ...], tuple[str, ...]]:
    """Timings of every model but the plant with each of its engines, and notes on missing ones."""
    timings, notes = [], []
    with one_thread(torch.device("cpu")):
        for one in judged:
            name = one.evaluation.name
            calls = {} if name == PLANT else _engines(one.model, one.data)
            if one.model.networks:
                try:
                    calls["kernel, streamed"] = _kernel_call(one.model, one.data)
                except RequestError as error:
                    notes.append(f"the kernel of {name} is not timed: {error}")
            timings += [_timed(name, engine, *call) for engine, call in calls.items()]
    return tuple(timings), tuple(notes)


def time_network(model: TrainedModel, data: LabelledRows) -> float:
    """Median seconds of one prediction by torch, a whole window at a time; in the threads that are set."""
    network, window = model.networks[0], _window(model, data)
    return _timed("", "", lambda: network(window), 1).median


def _engines(model: TrainedModel, data: LabelledRows) -> dict[str, tuple[Callable[[], object], int]]:
    """A function to call for each engine, and the number of predictions of a call."""
    if not model.networks:
        return {"C, 128 rows a call": (_physics_call(model, data), BLOCK)}
    window = _window(model, data)
    network, stream = model.networks[0], Stream(model.networks[0], model.config)
    for column in window[0, :-1]:
        stream.push(column[None])
    return {
        "torch, window": (lambda: network(window), 1),
        "torch, streamed": (lambda: stream.push(window[:, -1]), 1),
        "onnxruntime": (_onnx_call(model, data), 1),
    }


def _window(model: TrainedModel, data: LabelledRows) -> torch.Tensor:
    """The first window of the flights, (1, T, inputs), standardised."""
    columns = data.inputs[data.ends[0] + np.arange(1 - model.config.history, 1)]
    return torch.from_numpy((columns - model.scaling.input_mean) / model.scaling.input_std).float()[None]


def _onnx_call(model: TrainedModel, data: LabelledRows) -> Callable[[], object]:
    """A prediction by a bundle's model.onnx: network and base model from a window in SI units."""
    proto = onnx_model(exported(model), {})
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    session = onnxruntime.InferenceSession(proto.SerializeToString(), options, providers=["CPUExecutionProvider"])
    columns = np.hstack([data.state, data.rotor_speed])
    rows = data.ends[0] + np.arange(1 - model.config.history, 1)
    feed = {}
    for place, needed in enumerate(session.get_inputs()):
        shape = [size if isinstance(size, int) else 1 for size in needed.shape]
        feed[needed.name] = columns[rows].T[None].astype(np.float32) if place == 0 else np.zeros(shape, np.float32)
    return lambda: session.run(None, feed)


def _kernel_call(model: TrainedModel, data: LabelledRows) -> tuple[Callable[[], object], int]:
    """The compiled kernel along a flight's columns. Raises RequestError without a compiler or for other models."""
    from export.kernel import kernel_solver  # with the runtime, which nothing else here needs
    from runtime.control.rti.problem import Problem
    from runtime.control.rti.processor import native_processor

    bundle = exported(model)
    assert bundle.network is not None
    solver = kernel_solver(bundle.network, bundle.flight_model, Problem(), native_processor(), mean=bundle.mean)
    columns = np.hstack([data.state, data.rotor_speed])
    first, back = int(data.ends[0]), len(solver.history)
    solver.history[:] = columns[first + 1 - back : first + 1]
    rows = np.resize(columns[first + 1 : first + 1 + COLUMNS], (COLUMNS, columns.shape[1]))
    return lambda: solver.stream(rows), COLUMNS


def _physics_call(model: TrainedModel, data: LabelledRows) -> Callable[[], object]:
    rows = RowModel(
        model.vehicle, model.vehicle.effects, dt=model.config.dt, label=model.config.label, motors=model.config.motors
    )
    state = data.state[:BLOCK]
    speed = data.rotor_speed[:BLOCK]
    return lambda: rows(state, speed)


def _timed(model: str, engine: str, call: Callable[[], object], predictions: int) -> Inference:
    taken = np.empty(REPEATS)
    with torch.no_grad():
        for _ in range(WARM_UP):
            call()
        for place in range(REPEATS):
            began = time.perf_counter()
            call()
            taken[place] = time.perf_counter() - began
    median, slowest = np.quantile(taken / predictions, [0.5, 0.9])
    return Inference(model, engine, float(median), float(slowest))
