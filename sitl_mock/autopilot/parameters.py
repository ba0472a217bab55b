"""The parameter store and its protocol: values by name and index, PX4's byte-wise integers, PARAM_ERROR."""

from __future__ import annotations

import difflib
import math
import struct
import zlib

from dynamics.errors import RequestError
from sitl_mock.autopilot.parameter_table import FLOAT_DEFAULTS, INTEGER_DEFAULTS, LIMITS
from sitl_mock.vehicle.vehicle_interface import Tuning
from sitl_mock.wire.dialect import Message, mavlink

Requester = tuple[int, int]  # system and component

INT32, REAL32 = 6, 9
DOES_NOT_EXIST, OUT_OF_RANGE, TYPE_MISMATCH = 1, 2, 7
HASH_NAME = "_HASH_CHECK"
NO_INDEX = 0xFFFF


class Parameters:
    """PX4's parameters as a mapping from names to numbers, integers where PX4's are INT32."""

    def __init__(self, overrides: dict[str, float] | None = None):
        self._values: dict[str, float | int] = dict(sorted({**FLOAT_DEFAULTS, **INTEGER_DEFAULTS}.items()))
        self.names = list(self._values)
        self._indices = {name: index for index, name in enumerate(self.names)}
        for name, value in (overrides or {}).items():
            self.override(name, value)

    def __getitem__(self, name: str) -> float:
        return self._values[name]

    def __len__(self) -> int:
        return len(self._values)

    def override(self, name: str, value: float) -> None:
        """Set a value before the flight.

        Raises RequestError for a name that the mock lacks or a value that PX4 does not allow.
        """
        if name not in self._values:
            near = difflib.get_close_matches(name, self.names, 1)
            hint = f"; did you mean {near[0]}?" if near else ""
            raise RequestError(f"parameter {name} is not one of the {len(self)} that the mock knows{hint}")
        if not self._is_allowed(name, value):
            low, high = LIMITS.get(name, (-math.inf, math.inf))
            kind = "a whole number" if self.is_integer(name) else "a number"
            raise RequestError(f"parameter {name} = {value}: wanted {kind} from {low:g} to {high:g}")
        self._values[name] = int(value) if self.is_integer(name) else float(value)

    def is_integer(self, name: str) -> bool:
        """Whether the parameter is an INT32."""
        return isinstance(self._values[name], int)

    def _is_allowed(self, name: str, value: float) -> bool:
        low, high = LIMITS.get(name, (-math.inf, math.inf))
        if not math.isfinite(value) or not low <= value <= high:
            return False
        return not self.is_integer(name) or float(value).is_integer()

    def _within_limits(self, name: str) -> float:
        low, high = LIMITS[name]
        return min(max(self[name], low), high)

    def tuning(self) -> Tuning:
        """The parameters of the inner loops.

        PARAM_SET, like PX4's, stores any number; unflyable values are used at the limits of PX4's meta data.
        """

        def three(pattern: str) -> tuple[float, float, float]:
            roll, pitch, yaw = (float(self[pattern.format(axis)]) for axis in ("ROLL", "PITCH", "YAW"))
            return roll, pitch, yaw

        def gains(part: str) -> tuple[float, float, float]:
            """PX4's parallel form: a factor K on each of P, I and D."""
            factor, own = three("MC_{}RATE_K"), three(f"MC_{{}}RATE_{part}")
            return factor[0] * own[0], factor[1] * own[1], factor[2] * own[2]

        limits = three("MC_{}RATE_MAX")
        return Tuning(
            attitude_gain=three("MC_{}_P"),
            rate_gain_p=gains("P"),
            rate_gain_i=gains("I"),
            rate_gain_d=gains("D"),
            rate_limit=(math.radians(limits[0]), math.radians(limits[1]), math.radians(limits[2])),
            thrust_model_factor=self._within_limits("THR_MDL_FAC"),
            hover_thrust=self._within_limits("MPC_THR_HOVER"),
            return_altitude=self._within_limits("RTL_RETURN_ALT"),
            land_speed=self._within_limits("MPC_LAND_SPEED"),
            rate_gain_ff=three("MC_{}RATE_FF"),
            integral_limit=(self["MC_RR_INT_LIM"], self["MC_PR_INT_LIM"], self["MC_YR_INT_LIM"]),
            yaw_weight=self._within_limits("MC_YAW_WEIGHT"),
            gyro_cutoff=self._within_limits("IMU_GYRO_CUTOFF"),
            acceleration_cutoff=self._within_limits("IMU_DGYRO_CUTOFF"),
            yaw_torque_cutoff=self._within_limits("MC_YAW_TQ_CUTOFF"),
        )

    def value_message(self, name: str) -> Message:
        """PARAM_VALUE of a parameter."""
        kind = INT32 if self.is_integer(name) else REAL32
        value = self._values[name]
        wire = _float_of_bytes("<i", value) if kind == INT32 else float(value)
        return mavlink.MAVLink_param_value_message(name.encode(), wire, kind, len(self), self._indices[name])

    def hash_message(self) -> Message:
        """PARAM_VALUE of the pseudo parameter by which clients keep a cache of all values."""
        digest = 0
        for name, value in self._values.items():
            raw = struct.pack("<i", value) if self.is_integer(name) else struct.pack("<f", value)
            digest = zlib.crc32(name.encode() + raw, digest)
        wire = _float_of_bytes("<I", digest)
        return mavlink.MAVLink_param_value_message(HASH_NAME.encode(), wire, 5, len(self), NO_INDEX)

    def read(self, name: str, index: int, requester: Requester) -> Message:
        """The answer to PARAM_REQUEST_READ: by index, or by name where the index is -1."""
        if index >= 0:
            if index >= len(self):
                return error_message(requester, "", index, DOES_NOT_EXIST)
            return self.value_message(self.names[index])
        if name == HASH_NAME:
            return self.hash_message()
        if name not in self._values:
            return error_message(requester, name, index, DOES_NOT_EXIST)
        return self.value_message(name)

    def set(self, name: str, wire_value: float, kind: int, requester: Requester) -> tuple[Message, bool]:
        """The answer to PARAM_SET, and whether the value changed (then PX4 announces it a second time)."""
        if name not in self._values:
            return error_message(requester, name, -1, DOES_NOT_EXIST), False
        if kind != (INT32 if self.is_integer(name) else REAL32):
            return error_message(requester, name, -1, TYPE_MISMATCH), False
        value = struct.unpack("<i", struct.pack("<f", wire_value))[0] if kind == INT32 else wire_value
        if not math.isfinite(value):
            return error_message(requester, name, -1, OUT_OF_RANGE), False
        changed = self._values[name] != value
        self._values[name] = value
        return self.value_message(name), changed


def error_message(requester: Requester, name: str, index: int, reason: int) -> Message:
    """PARAM_ERROR about a parameter, to the system and component that requested it."""
    return mavlink.MAVLink_param_error_message(*requester, name.encode()[:16], index, reason)


def _float_of_bytes(layout: str, value: float) -> float:
    number: float = struct.unpack("<f", struct.pack(layout, value))[0]
    return number
