"""model.onnx: the network as Conv and Gemm, inputs and physics translated operation by operation from CasADi."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import count
from typing import Any

import casadi as ca
import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from dynamics.errors import DataError
from dynamics.state import RIGID_BODY_STATES
from export.network import Network
from export.symbolic import assembly_function, features_function
from export.trained import ExportedModel

OPSET = 17
IR_VERSION = 8
_SIMPLE = {
    ca.OP_ADD: "Add", ca.OP_SUB: "Sub", ca.OP_MUL: "Mul", ca.OP_DIV: "Div", ca.OP_NEG: "Neg", ca.OP_SQRT: "Sqrt",
    ca.OP_SIN: "Sin", ca.OP_COS: "Cos", ca.OP_TAN: "Tan", ca.OP_EXP: "Exp", ca.OP_LOG: "Log", ca.OP_FABS: "Abs",
    ca.OP_POW: "Pow", ca.OP_CONSTPOW: "Pow", ca.OP_TANH: "Tanh", ca.OP_FMIN: "Min", ca.OP_FMAX: "Max",
    ca.OP_SIGN: "Sign", ca.OP_ATAN: "Atan", ca.OP_ASIN: "Asin", ca.OP_ACOS: "Acos", ca.OP_INV: "Reciprocal",
    ca.OP_FLOOR: "Floor", ca.OP_CEIL: "Ceil", ca.OP_SINH: "Sinh", ca.OP_COSH: "Cosh",
}  # fmt: skip
_LOGIC = {ca.OP_LT: "Less", ca.OP_LE: "LessOrEqual", ca.OP_EQ: "Equal"}


class Graph:
    """Nodes and constants of a graph under construction; values are float32."""

    def __init__(self) -> None:
        self.nodes: list[onnx.NodeProto] = []
        self.constants: list[onnx.TensorProto] = []
        self._numbers = count()
        self._scalars: dict[float, str] = {}

    def add(self, operation: str, *inputs: str, outputs: int = 1, **attributes: Any) -> str:
        """A node; returns the name of its first output. Further ones have the same name with .1, .2, .."""
        name = f"{operation.lower()}_{next(self._numbers)}"
        names = [name, *(f"{name}.{i}" for i in range(1, outputs))]
        self.nodes.append(helper.make_node(operation, list(inputs), names, **attributes))
        return name

    def constant(self, values: object, *, integers: bool = False) -> str:
        """A constant tensor's name."""
        name = f"constant_{next(self._numbers)}"
        array = np.asarray(values, dtype=np.int64 if integers else np.float32)
        self.constants.append(numpy_helper.from_array(np.array(array, order="C"), name))
        return name

    def scalar(self, value: float) -> str:
        """A scalar constant, shared by all who need it."""
        if value not in self._scalars:
            self._scalars[value] = self.constant(value)
        return self._scalars[value]

    def rows(self, tensor: str, number: int) -> list[str]:
        """A tensor (batch, number, ..) as its rows (batch, 1, ..)."""
        first = self.add("Split", tensor, self.constant([1] * number, integers=True), outputs=number, axis=1)
        return [first, *(f"{first}.{i}" for i in range(1, number))]

    def output(self, name: str, rows: Sequence[str], *, like: str) -> None:
        """Name the rows (batch, 1) side by side. like: a row, after whose shape those that are constants are filled."""
        nothing = self.add("Mul", like, self.scalar(0.0))
        constant = set(self._scalars.values())
        columns = [self.add("Add", row, nothing) if row in constant else row for row in rows]
        self.nodes.append(helper.make_node("Concat", columns, [name], axis=1))

    def translate(self, function: ca.Function, inputs: Sequence[Sequence[str]]) -> list[list[str]]:
        """A CasADi SX function on rows: each scalar becomes a row. Raises DataError for what ONNX does not have."""
        work: dict[int, str] = {}
        outputs = [[""] * function.numel_out(i) for i in range(function.n_out())]
        for k in range(function.n_instructions()):
            code, taken, results = (
                function.instruction_id(k),
                function.instruction_input(k),
                function.instruction_output(k),
            )
            if code == ca.OP_INPUT:
                work[results[0]] = inputs[taken[0]][taken[1]]
            elif code == ca.OP_OUTPUT:
                outputs[results[0]][results[1]] = work[taken[0]]
            elif code == ca.OP_CONST:
                work[results[0]] = self.scalar(float(function.instruction_constant(k)))
            else:
                work[results[0]] = self._operation(code, [work[place] for place in taken])
        return outputs

    def _operation(self, code: int, inputs: list[str]) -> str:
        if code in _SIMPLE:
            return self.add(_SIMPLE[code], *inputs)
        if code == ca.OP_SQ:
            return self.add("Mul", inputs[0], inputs[0])
        if code == ca.OP_TWICE:
            return self.add("Add", inputs[0], inputs[0])
        if code == ca.OP_ASSIGN:
            return inputs[0]
        if code == ca.OP_IF_ELSE_ZERO:
            return self.add("Mul", *inputs)
        if code in _LOGIC:
            return self.add("Cast", self.add(_LOGIC[code], *inputs), to=TensorProto.FLOAT)
        if code == ca.OP_NOT:
            return self.add("Sub", self.scalar(1.0), inputs[0])
        if code == ca.OP_AND:
            return self.add("Mul", *inputs)
        if code == ca.OP_OR:
            return self.add("Max", *inputs)
        raise DataError(
            f"this model needs CasADi's operation {code}, which the ONNX export does not know. Leave the effect that "
            "uses it out of the vehicle file."
        )


def onnx_model(model: ExportedModel, metadata: Mapping[str, str]) -> onnx.ModelProto:
    """The model for windows `history` (batch, 13 + rotors, T) and, where the physics has any, `hidden` (batch, n).

    Outputs: `acceleration` (batch, 6), `hidden_rate` (batch, n), of an ensemble `uncertainty` (batch, 1); all float32.
    """
    graph = Graph()
    size = RIGID_BODY_STATES + model.vehicle.rotors.count
    newest = graph.add("Gather", "history", graph.constant(model.history - 1, integers=True), axis=2)
    uncertainty, output_rows = None, list[str]()
    if model.network is not None:
        output, uncertainty = _flown_output(graph, model, model.network)
        output_rows = graph.rows(output, 6)
    hidden = graph.rows("hidden", model.hidden_count) if model.hidden_count else []
    columns = graph.rows(newest, size)
    acceleration, rate = graph.translate(assembly_function(model), [output_rows, columns, hidden])
    graph.output("acceleration", acceleration, like=columns[0])
    kind = TensorProto.FLOAT
    inputs = [helper.make_tensor_value_info("history", kind, ["batch", size, model.history])]
    outputs = [helper.make_tensor_value_info("acceleration", kind, ["batch", 6])]
    if model.hidden_count:
        graph.output("hidden_rate", rate, like=columns[0])
        inputs.append(helper.make_tensor_value_info("hidden", kind, ["batch", model.hidden_count]))
        outputs.append(helper.make_tensor_value_info("hidden_rate", kind, ["batch", model.hidden_count]))
    if uncertainty is not None:
        graph.nodes.append(helper.make_node("Identity", [uncertainty], ["uncertainty"]))
        outputs.append(helper.make_tensor_value_info("uncertainty", kind, ["batch", 1]))
    body = helper.make_graph(graph.nodes, "alula_model", inputs, outputs, graph.constants)
    made = helper.make_model(body, opset_imports=[helper.make_opsetid("", OPSET)], producer_name="alula")
    made.ir_version = IR_VERSION
    helper.set_model_props(made, dict(metadata))
    onnx.checker.check_model(made, full_check=True)
    return made


def _flown_output(graph: Graph, model: ExportedModel, network: Network) -> tuple[str, str | None]:
    """The network's output (batch, 6), in SI, as far as the members' disagreement leaves it, and the uncertainty."""
    size = RIGID_BODY_STATES + network.rotors
    (features,) = graph.translate(features_function(network), [graph.rows("history", size)])
    columns = graph.add("Concat", *features, axis=1)
    output, ensemble = _network_output(graph, network, columns), model.ensemble
    if ensemble is None:
        return output, None
    members = [output, *(_network_output(graph, member, columns) for member in ensemble.others)]
    mean = graph.add("Mean", *members)
    square = graph.add("Sum", *(_squared(graph, graph.add("Sub", member, mean), network) for member in members))
    scale = 1 / (6 * len(ensemble.others) * ensemble.limit**2)
    excess = graph.add("Mul", graph.add("ReduceSum", square, graph.constant([1], integers=True)), graph.scalar(scale))
    if ensemble.fades:
        output = graph.add("Div", output, graph.add("Max", excess, graph.scalar(1.0)))
    return output, graph.add("Sqrt", excess)


def _squared(graph: Graph, away: str, network: Network) -> str:
    """Squares (batch, 6) of a deviation in the outputs' standard deviations."""
    standardised = graph.add("Div", away, graph.constant(network.output_std))
    return graph.add("Mul", standardised, standardised)


def _network_output(graph: Graph, network: Network, columns: str) -> str:
    """A member's output (batch, 6), in SI. columns: (batch, features, T)."""
    value = columns
    for layer in network.convolutions:
        weight, bias = graph.constant(layer.weight), graph.constant(layer.bias)
        taps, dilation = [layer.weight.shape[2]], [layer.dilation]
        value = graph.add("Relu", graph.add("Conv", value, weight, bias, kernel_shape=taps, dilations=dilation))
    value = graph.add("Gather", value, graph.constant(-1, integers=True), axis=2)
    for i, dense in enumerate(network.perceptron):
        value = graph.add("Gemm", value, graph.constant(dense.weight.T), graph.constant(dense.bias))
        if i + 1 < len(network.perceptron):
            value = graph.add("Relu", value)
    return graph.add(
        "Add", graph.add("Mul", value, graph.constant(network.output_std)), graph.constant(network.output_mean)
    )
