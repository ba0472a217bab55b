"""A model as CasADi functions, written from the same numbers as the kernel: what ONNX and the C files come from.

Every backend has one interface: a window of columns in, accelerations out. A column is position, velocity_world,
attitude, rate_body, then rotor speeds in rad/s, all raw; standardising and turning to body axes happen inside.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import casadi as ca

from dynamics import quaternion
from dynamics.model import ENVIRONMENT_DEFAULT, Model
from dynamics.network_inputs import state_inputs
from dynamics.state import ATTITUDE, RIGID_BODY_STATES
from dynamics.vehicle import GRAVITY
from export.network import Convolution, Ensemble, Network
from export.physics import physics_function

if TYPE_CHECKING:
    from export.trained import ExportedModel  # imports torch, which the environment of the acados benchmark lacks

FORWARD, JACOBIAN = "alula_model", "alula_model_jacobian"
COLUMN_NAMES = (
    "position_x", "position_y", "position_z", "velocity_x", "velocity_y", "velocity_z",
    "attitude_w", "attitude_x", "attitude_y", "attitude_z", "rate_x", "rate_y", "rate_z",
)  # fmt: skip
COLUMN_UNITS = (*["m"] * 3, *["m/s"] * 3, *["1"] * 4, *["rad/s"] * 3)


def column_names(rotors: int) -> tuple[str, ...]:
    """Names of a column's entries."""
    return (*COLUMN_NAMES, *(f"rotor_speed_{rotor}" for rotor in range(rotors)))


def column_units(rotors: int) -> tuple[str, ...]:
    """Units of a column's entries."""
    return (*COLUMN_UNITS, *["rad/s"] * rotors)


def features_function(network: Network) -> ca.Function:
    """A raw column (13 + rotors) -> standardised features."""
    column = ca.SX.sym("column", RIGID_BODY_STATES + network.rotors)
    state, rotor_speed = column[:RIGID_BODY_STATES], column[RIGID_BODY_STATES:]
    raw = ca.vertcat(state_inputs(network.inputs, state), rotor_speed)
    return ca.Function("features", [column], [(raw - network.input_mean) / network.input_std])


def assembly_function(model: ExportedModel) -> ca.Function:
    """(output, column, hidden) -> acceleration (6), world and body axes, and the hidden states' rates.

    output: (6,) of the network, in SI; empty without one.
    """
    network, physics = model.network, model.physics
    rotors = model.vehicle.rotors.count
    output = ca.SX.sym("output", 0 if network is None else 6)
    column, hidden = ca.SX.sym("column", RIGID_BODY_STATES + rotors), ca.SX.sym("hidden", model.hidden_count)
    linear, angular = ca.SX.zeros(3), ca.SX.zeros(3)
    if network is not None:
        turned = network.outputs == "body"
        linear = quaternion.rotate(column[ATTITUDE], output[0:3]) if turned else output[0:3]
        angular = output[3:6]
        if turned and physics is None:
            linear = linear - ca.vertcat(0, 0, GRAVITY)
    rates = ca.SX.zeros(6) if physics is None else _rates(physics, model, column, hidden)
    acceleration = ca.vertcat(linear, angular) + rates[0:6]
    parts = [ca.densify(part) for part in ca.cse([acceleration, rates[6:]])]
    return ca.Function("assembly", [output, column, hidden], parts)


def _rates(physics: Model, model: ExportedModel, column: ca.SX, hidden: ca.SX) -> ca.SX:
    function = physics_function(physics, dt=model.config.dt, mean=model.mean)
    state = ca.vertcat(column[:RIGID_BODY_STATES], hidden)
    return function(state, column[RIGID_BODY_STATES:], physics.parameter_values, ENVIRONMENT_DEFAULT)[0]


def model_function(model: ExportedModel) -> ca.Function:
    """(history (13 + rotors, T) oldest column first, hidden) -> acceleration (6), hidden_rate.

    An ensemble's has a third output, uncertainty: the members' disagreement over its limit. The acceleration has as
    much of a residual as that leaves.
    """
    history, hidden = _arguments(model)
    names = ["history", "hidden"], ["acceleration", "hidden_rate"]
    if model.ensemble is None or model.network is None:
        output = ca.MX(0, 1) if model.network is None else network_output(model.network, history)
        return ca.Function(
            FORWARD, [history, hidden], [*assembly_function(model)(output, history[:, -1], hidden)], *names
        )
    output, excess = network_output(model.network, history), excess_of(model.network, model.ensemble, history)
    share = 1 / ca.fmax(excess, 1) if model.ensemble.fades else 1
    outputs = assembly_function(model)(share * output, history[:, -1], hidden)
    names[1].append("uncertainty")
    return ca.Function(FORWARD, [history, hidden], [*outputs, ca.sqrt(excess)], *names)


def weighted_function(model: ExportedModel) -> ca.Function:
    """(history, hidden, share) -> acceleration (6), hidden_rate, with that share of the network's output."""
    history, hidden = _arguments(model)
    share = ca.MX.sym("share")
    output = ca.MX(0, 1) if model.network is None else share * network_output(model.network, history)
    outputs = assembly_function(model)(output, history[:, -1], hidden)
    return ca.Function("weighted_model", [history, hidden, share], list(outputs))


def _arguments(model: ExportedModel) -> tuple[ca.MX, ca.MX]:
    rows = RIGID_BODY_STATES + model.vehicle.rotors.count
    return ca.MX.sym("history", rows, model.history), ca.MX.sym("hidden", model.hidden_count)


def excess_of(network: Network, ensemble: Ensemble, history: ca.MX) -> ca.MX:
    """Mean square of the members' standardised deviation over that from which on a residual fades."""
    outputs = ca.horzcat(*(network_output(member, history) for member in (network, *ensemble.others)))
    away = (outputs - ca.repmat(ca.sum2(outputs) / outputs.shape[1], 1, outputs.shape[1])) / ca.DM(network.output_std)
    return ca.sumsqr(away) / (away.shape[0] * len(ensemble.others) * ensemble.limit**2)


def jacobian_function(model: ExportedModel) -> ca.Function:
    """(history, hidden) -> d acceleration / d history (6, (13 + rotors) T), columns in the window's order."""
    forward = model_function(model)
    history = ca.MX.sym("history", *forward.size_in("history"))
    hidden = ca.MX.sym("hidden", forward.size1_in("hidden"))
    acceleration = forward(history, hidden)[0]
    jacobian = ca.densify(ca.jacobian(acceleration, ca.vec(history)))
    return ca.Function(JACOBIAN, [history, hidden], [jacobian], ["history", "hidden"], ["by_history"])


def network_output(network: Network, history: ca.MX) -> ca.MX:
    """Output (6,) of the network for raw columns (13 + rotors, T), evaluated over the receptive cone of the newest."""
    newest = history.shape[1] - 1
    needed = [{newest}]
    for layer in reversed(network.convolutions):
        taps = range(layer.weight.shape[2])
        needed.insert(0, {t - tap * layer.dilation for t in needed[0] for tap in taps})
    features = features_function(network)
    values = {t: features(history[:, t]) for t in sorted(needed[0])}
    for layer, positions in zip(network.convolutions, needed[1:], strict=True):
        values = {t: ca.fmax(_convolve(layer, values, t), 0) for t in sorted(positions)}
    value = values[newest]
    for i, dense in enumerate(network.perceptron):
        value = ca.DM(dense.weight) @ value + ca.DM(dense.bias)
        if i + 1 < len(network.perceptron):
            value = ca.fmax(value, 0)
    return ca.DM(network.output_mean) + ca.DM(network.output_std) * value


def _convolve(layer: Convolution, values: dict[int, ca.MX], t: int) -> ca.MX:
    taps = layer.weight.shape[2]
    inputs = ca.vertcat(*[values[t - (taps - 1 - tap) * layer.dilation] for tap in range(taps)])
    weight = layer.weight.transpose(0, 2, 1).reshape(layer.weight.shape[0], -1)
    return ca.DM(weight) @ inputs + ca.DM(layer.bias)
