"""The check of a setpoint that may be the last one, in a kernel's C code (last_setpoint.h); docs/last_setpoint.md."""

from __future__ import annotations

import ctypes
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from dynamics.arrays import Floats
from dynamics.trust import Library

NUMBER, AXES = ctypes.c_double, ctypes.c_double * 3


class LastSetpointModel(ctypes.Structure):
    """The C struct last_setpoint_model: what the check knows of vehicle, autopilot and surroundings.

    hold: s from a setpoint until the failsafe acts, at the latest.
    lag: (3,) s, of body rates behind their setpoints. thrust_lag: s.
    mass: kg. drag: linear, over the mass, 1/s.
    thrust_max: N, by the present effectiveness.
    rate_max: (3,) rad/s, of setpoints.
    attitude_gain, attitude_rate_max: of the failsafe, 1/s and rad/s. sink: m/s, of its landing.
    patience: s of the failsafe that are predicted, at most.
    low, high: (3,) m, corners of the box; infinite without one.
    ground: m, height at which the vehicle touches the ground; -infinite where it is not known.
    edge, spread: m from the box's sides, and m/s by which the prediction's error grows.
    touch_speed, touch_upright: m/s downwards and cosine of the tilt, up to which a contact is a landing.
    """

    _fields_ = (
        ("hold", NUMBER),
        ("lag", AXES),
        ("thrust_lag", NUMBER),
        ("mass", NUMBER),
        ("drag", NUMBER),
        ("thrust_max", NUMBER),
        ("rate_max", AXES),
        ("attitude_gain", NUMBER),
        ("attitude_rate_max", NUMBER),
        ("sink", NUMBER),
        ("patience", NUMBER),
        ("low", AXES),
        ("high", AXES),
        ("ground", NUMBER),
        ("edge", NUMBER),
        ("spread", NUMBER),
        ("touch_speed", NUMBER),
        ("touch_upright", NUMBER),
    )


class Outcome(IntEnum):
    """Outcome of the check of a setpoint."""

    PASSES = 0
    REPLACED = 1
    NONE_PASSES = 2


class CheckedSetpoint(NamedTuple):
    """A setpoint that may leave.

    rate_body: (3,) rad/s. collective_thrust: N.
    harm_given, harm: of the given and of this setpoint if it is the last one, m outside of the box plus m/s of an
        impact.
    """

    outcome: Outcome
    rate_body: Floats
    collective_thrust: float
    harm_given: float
    harm: float


class LastSetpointCheck:
    """Checks setpoints, and replaces those that must not be the last ones. An instance belongs to one thread.

    model: of vehicle, autopilot and surroundings, read at each call.
    """

    def __init__(self, code: Library, model: LastSetpointModel) -> None:
        self.model = model
        self._state, self._setpoint, self._harm = np.zeros(13), np.zeros(4), np.zeros(2)
        state, setpoint, harm = (
            ctypes.c_void_p(array.ctypes.data) for array in (self._state, self._setpoint, self._harm)
        )
        self._pointers = ctypes.byref(model), state, setpoint, harm
        self._check, self._of_one = code.last_setpoint_check, code.last_setpoint_harm
        pointer = ctypes.c_void_p
        self._check.argtypes = (pointer, pointer, NUMBER, NUMBER, pointer, pointer)
        self._of_one.argtypes, self._of_one.restype = (pointer, pointer, NUMBER, NUMBER, pointer), NUMBER

    def check(
        self, state: Floats, age: float, thrust_now: float, rate_body: Floats, collective_thrust: float
    ) -> CheckedSetpoint:
        """Check a setpoint before it leaves.

        state: (13,) as it was `age` s before the setpoint acts. thrust_now: N, that acts until then.
        rate_body: (3,) rad/s and collective_thrust, N, of the setpoint.
        """
        self._state[:], self._setpoint[:3], self._setpoint[3] = state[:13], rate_body, collective_thrust
        model, at_state, at_setpoint, at_harm = self._pointers
        outcome = Outcome(self._check(model, at_state, age, thrust_now, at_setpoint, at_harm))
        before, after = self._harm.tolist()
        return CheckedSetpoint(outcome, self._setpoint[:3].copy(), float(self._setpoint[3]), before, after)

    def harm(self, state: Floats, age: float, thrust_now: float, rate_body: Floats, collective_thrust: float) -> float:
        """Harm of a setpoint, which is not replaced; arguments as of `check`."""
        self._state[:], self._setpoint[:3], self._setpoint[3] = state[:13], rate_body, collective_thrust
        model, at_state, at_setpoint, _ = self._pointers
        return float(self._of_one(model, at_state, age, thrust_now, at_setpoint))
