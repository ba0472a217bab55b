"""A network without history as a vector field, for an integrator that evaluates it at states of its own choice."""

from __future__ import annotations

import casadi as ca

from dynamics import quaternion
from dynamics.model import ENVIRONMENT_DEFAULT
from dynamics.state import ATTITUDE, RATE, RIGID_BODY_STATES, VELOCITY
from export.network import Network
from export.symbolic import assembly_function, features_function
from export.trained import ExportedModel


def field_function(model: ExportedModel) -> ca.Function:
    """(x, u, p, e) -> xdot, and its derivatives by x and by u. p, e: not used, the model holds its own numbers.

    The network's Jacobian is written out as one product of matrices: CasADi's own, a sweep for each of six outputs,
    takes several times as long.
    """
    flown, network = model.flight_model, model.network
    assert network is not None
    x, u = ca.MX.sym("x", flown.state_count), ca.MX.sym("u", flown.input_count)
    p, e = ca.MX.sym("p", flown.parameter_values.size), ca.MX.sym("e", ENVIRONMENT_DEFAULT.size)
    column = ca.vertcat(x[:RIGID_BODY_STATES], u)
    hidden = x[RIGID_BODY_STATES:]
    features, by_column = _with_derivatives(features_function(network))(column)
    output, by_features = _perceptron(network, features)
    rate, by_output, by_column_itself, by_hidden = _with_derivatives(_rate_function(model))(output, column, hidden)
    by_column = by_column_itself + by_output @ (by_features @ by_column)
    by_state = ca.horzcat(by_column[:, :RIGID_BODY_STATES], by_hidden)
    parts = [ca.densify(part) for part in (rate, by_state, by_column[:, RIGID_BODY_STATES:])]
    return ca.Function("field", [x, u, p, e], parts, ["x", "u", "p", "e"], ["rate", "by_state", "by_input"])


def _perceptron(network: Network, features: ca.MX) -> tuple[ca.MX, ca.MX]:
    """Output (6,) of the network for one column's features, and its derivative by them (6, features)."""
    values, masks = [features], []
    for dense in network.perceptron[:-1]:
        before = ca.DM(dense.weight) @ values[-1] + ca.DM(dense.bias)
        values.append(ca.fmax(before, 0))
        masks.append(before > 0)
    last = network.perceptron[-1]
    output = ca.DM(network.output_mean) + ca.DM(network.output_std) * (
        ca.DM(last.weight) @ values[-1] + ca.DM(last.bias)
    )
    slope = ca.MX(ca.DM(network.output_std[:, None] * last.weight))
    for dense, mask in zip(reversed(network.perceptron[:-1]), reversed(masks), strict=True):
        slope = (slope * ca.repmat(mask.T, 6, 1)) @ ca.DM(dense.weight)
    return output, slope


def _rate_function(model: ExportedModel) -> ca.Function:
    """(output, column, hidden) -> xdot."""
    assembly = assembly_function(model)
    output, column, hidden = (ca.SX.sym(assembly.name_in(i), assembly.size1_in(i)) for i in range(3))
    acceleration, hidden_rate = assembly(output, column, hidden)
    turning = quaternion.derivative(column[ATTITUDE], column[RATE])
    rate = ca.vertcat(column[VELOCITY], acceleration[:3], turning, acceleration[3:], hidden_rate)
    return ca.Function("rate", [output, column, hidden], [rate])


def _with_derivatives(function: ca.Function) -> ca.Function:
    """Function with the derivatives of its output by each input behind it."""
    inputs = [ca.SX.sym(function.name_in(i), function.size1_in(i)) for i in range(function.n_in())]
    output = function(*inputs)
    derivatives = [ca.densify(ca.jacobian(output, argument)) for argument in inputs]
    return ca.Function(f"{function.name()}_slopes", inputs, ca.cse([ca.densify(output), *derivatives]))
