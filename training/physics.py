"""A vehicle's model over all rows of a data set, as machine code: the prior of the loss and the base of residuals.

The formulas are those of `dynamics`; a network gets their values only, no derivatives.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import casadi as ca
import numpy as np

from dynamics import quaternion
from dynamics.arrays import Floats
from dynamics.codegen import compile_functions
from dynamics.effect import Effect
from dynamics.effects import CATALOGUE
from dynamics.integrators import required_steps, rk4, with_unit_attitude
from dynamics.model import ENVIRONMENT_DEFAULT, Model, build_model
from dynamics.own_effects import catalogue_of
from dynamics.state import ATTITUDE, RATE, RIGID_BODY_STATES, VELOCITY
from dynamics.vehicle import GRAVITY, EffectUse, Vehicle
from training.config import Label, Motors

BLOCK = 128  # rows a call


class ModelRows(NamedTuple):
    """body: (n, 6) body accelerations. following: (n, 13) the rigid body's state one step later."""

    body: Floats
    following: Floats


class RowModel:
    """A vehicle with effects, evaluated row by row; hidden states are carried from row to row.

    effects: none for the nominal model. motors: with measured rotor speeds there is no lag between them and the rotors.
    label: accelerations at the row, or their mean over the next dt with the input held (RK4). The ground is at z = 0
    and the battery full.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        effects: Sequence[EffectUse],
        *,
        dt: float,
        label: Label,
        motors: Motors,
        catalogue: Mapping[str, Effect] = CATALOGUE,
    ) -> None:
        catalogue = catalogue_of(vehicle, catalogue)
        self.model = build_model(vehicle, effects=_driven(effects, motors, catalogue), catalogue=catalogue)
        function = row_function(self.model, dt, label)
        # the carried state is only handed from row to row within one call
        self._code = compile_functions([function.mapaccum("rows", BLOCK)])["rows"]

    def __call__(self, state: Floats, rotor_speed: Floats, *, parameters: Floats | None = None) -> ModelRows:
        """Consecutive rows of one flight. state: (n, 13). rotor_speed: (n, rotors) rad/s, held until the next row.

        parameters: instead of the vehicle's own, in the model's order. Rows with NaN give NaN from there on.
        """
        p = self.model.parameter_values if parameters is None else parameters
        inputs, outputs = self._code.inputs, self._code.outputs
        inputs["p"][:] = np.tile(p, BLOCK)
        inputs["carried"][:] = initial_hidden(self.model, rotor_speed[:1])[0]
        body, following = np.empty((len(state), 6)), np.empty((len(state), RIGID_BODY_STATES))
        for start in range(0, len(state), BLOCK):
            stop = min(start + BLOCK, len(state))
            inputs["x"].reshape(BLOCK, -1)[: stop - start] = state[start:stop]
            inputs["u"].reshape(BLOCK, -1)[: stop - start] = rotor_speed[start:stop]
            self._code.run()
            body[start:stop] = outputs["body"].reshape(BLOCK, 6)[: stop - start]
            following[start:stop] = outputs["following"].reshape(BLOCK, -1)[: stop - start]
            inputs["carried"][:] = outputs["carried_on"].reshape(BLOCK, -1)[-1]
        return ModelRows(body, following)


class BatchModel:
    """A vehicle with effects, one row of m flights at a time; hidden states are carried from call to call."""

    def __init__(
        self,
        vehicle: Vehicle,
        effects: Sequence[EffectUse],
        rotor_speed: Floats,
        *,
        dt: float,
        label: Label,
        motors: Motors,
        catalogue: Mapping[str, Effect] = CATALOGUE,
    ) -> None:
        """rotor_speed: (m, rotors) rad/s at the first row, with rotors at these speeds."""
        catalogue = catalogue_of(vehicle, catalogue)
        model = build_model(vehicle, effects=_driven(effects, motors, catalogue), catalogue=catalogue)
        batched = row_function(model, dt, label).map(BLOCK)
        self._code = compile_functions([batched])[batched.name()]
        self._parameters = np.tile(model.parameter_values, BLOCK)
        self._carried = initial_hidden(model, rotor_speed)

    def __call__(self, state: Floats, rotor_speed: Floats) -> ModelRows:
        """state: (m, 13). rotor_speed: (m, rotors) rad/s, held until the next row."""
        inputs, outputs = self._code.inputs, self._code.outputs
        inputs["p"][:] = self._parameters
        body, following = np.empty((len(state), 6)), np.empty((len(state), RIGID_BODY_STATES))
        for start in range(0, len(state), BLOCK):
            rows = slice(start, min(start + BLOCK, len(state)))
            count = rows.stop - start
            for name, values in (("carried", self._carried), ("x", state), ("u", rotor_speed)):
                inputs[name].reshape(BLOCK, -1)[:count] = values[rows]
            self._code.run()
            body[rows] = outputs["body"].reshape(BLOCK, 6)[:count]
            following[rows] = outputs["following"].reshape(BLOCK, -1)[:count]
            self._carried[rows] = outputs["carried_on"].reshape(BLOCK, -1)[:count]
        return ModelRows(body, following)


def _driven(effects: Sequence[EffectUse], motors: Motors, catalogue: Mapping[str, Effect]) -> list[EffectUse]:
    """The effects that act on these motors: with measured rotor speeds none is a lag of the rotors."""
    return [use for use in effects if motors == "command" or catalogue[use.name].rotor_speed is None]


def initial_hidden(model: Model, rotor_speed: Floats) -> Floats:
    """(m, hidden + 1) hidden states of hover, with the rotors at the first commanded speeds (m, rotors), rad/s."""
    carried = np.zeros((len(rotor_speed), model.hidden_count + 1))
    carried[:, : model.hidden_count] = model.hidden_initial
    for place in model.rotor_speed_places:
        carried[:, place.start - RIGID_BODY_STATES : place.stop - RIGID_BODY_STATES] = rotor_speed
    return carried


def nominal_model(vehicle: Vehicle, *, dt: float, label: Label) -> RowModel:
    """The nominal model h_nom of the vehicle file's body and rotors (PI-TCN eq. 1, 2)."""
    return RowModel(vehicle, (), dt=dt, label=label, motors="command")


def row_function(model: Model, dt: float, label: Label) -> ca.Function:
    """(carried, x, u, p) -> carried_on, body, following; carried holds the hidden states and one number more."""
    hidden, spare = ca.SX.sym("hidden", model.hidden_count), ca.SX.sym("spare")
    x, u = ca.SX.sym("x", RIGID_BODY_STATES), ca.SX.sym("u", model.input_count)
    p, e, still = ca.SX.sym("p", len(model.parameter_names)), ENVIRONMENT_DEFAULT, ca.SX.zeros(model.hidden_count)
    state = ca.vertcat(x, hidden)
    steps = required_steps(model, dt)
    after = with_unit_attitude(rk4(lambda state: model.derivative(state, u, p, e, still), state, dt, steps=steps))
    if label == "mean_increment":
        acceleration = (after[VELOCITY] - x[VELOCITY]) / dt + ca.vertcat(0, 0, GRAVITY)
        body = ca.vertcat(quaternion.rotate_inverse(x[ATTITUDE], acceleration), (after[RATE] - x[RATE]) / dt)
    else:
        force, angular, _ = model.observe(state, u, p, e)
        body = ca.vertcat(force, angular)
    carried = ca.vertcat(hidden, spare)
    on = ca.vertcat(after[RIGID_BODY_STATES:], spare)
    outputs = [ca.densify(value) for value in (on, body, after[:RIGID_BODY_STATES])]
    names = ["carried", "x", "u", "p"], ["carried_on", "body", "following"]
    return ca.Function("row", [carried, x, u, p], outputs, *names)
