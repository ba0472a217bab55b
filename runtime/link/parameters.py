"""The vehicle's parameters, read and set by name; integers travel byte-wise in the float field (docs/px4.md)."""

from __future__ import annotations

import struct
from collections.abc import Iterable
from math import isclose

import msgspec

from runtime.link.dialect import Message, mavlink
from runtime.link.telemetry import enum_name
from runtime.link.vehicle_link import ATTEMPTS, NO_ANSWER, VehicleLink

_FORMATS = {
    mavlink.MAV_PARAM_TYPE_UINT8: "<Bxxx",
    mavlink.MAV_PARAM_TYPE_INT8: "<bxxx",
    mavlink.MAV_PARAM_TYPE_UINT16: "<Hxx",
    mavlink.MAV_PARAM_TYPE_INT16: "<hxx",
    mavlink.MAV_PARAM_TYPE_UINT32: "<I",
    mavlink.MAV_PARAM_TYPE_INT32: "<i",
    mavlink.MAV_PARAM_TYPE_REAL32: "<f",
}


class Parameter(msgspec.Struct, frozen=True):
    """A parameter of the vehicle.

    value: None if it could not be read or set.
    type: MAV_PARAM_TYPE.
    error: why, empty when there is none.
    """

    name: str
    value: float | int | None
    type: int = mavlink.MAV_PARAM_TYPE_REAL32
    error: str = ""


def decode_value(wire: float, kind: int) -> float | int:
    """The value in the float field of PARAM_VALUE. kind: MAV_PARAM_TYPE."""
    layout = _FORMATS.get(kind, "<f")
    value: float | int = struct.unpack(layout, struct.pack("<f", wire))[0]
    return value


def encode_value(value: float, kind: int) -> float:
    """The float field of PARAM_SET that carries a value. Raises ValueError when it does not fit the type."""
    layout = _FORMATS.get(kind, "<f")
    try:
        data = struct.pack(layout, value if layout == "<f" else int(value))
    except (struct.error, OverflowError) as error:
        raise ValueError(f"{value} does not fit parameter type {kind}: {error}") from None
    return float(struct.unpack("<f", data)[0])


def read_parameter(link: VehicleLink, name: str, *, timeout: float = 0.5, attempts: int = ATTEMPTS) -> Parameter:
    """Read a parameter; its error is no_answer if the vehicle does not answer."""

    def request(attempt: int) -> Message:
        status = link.status
        return mavlink.MAVLink_param_request_read_message(status.system, status.component, name.encode(), -1)

    answer = link.exchange(request, lambda message: _read(message, name), timeout=timeout, attempts=attempts)
    return answer or Parameter(name, None, error=NO_ANSWER)


def read_parameters(
    link: VehicleLink, names: Iterable[str], *, timeout: float = 0.5, attempts: int = ATTEMPTS
) -> dict[str, Parameter]:
    """Read parameters one after the other. A vehicle that does not answer the first is not asked for the others."""
    values: dict[str, Parameter] = {}
    for name in names:
        if values and next(iter(values.values())).error == NO_ANSWER:
            values[name] = Parameter(name, None, error=NO_ANSWER)
        else:
            values[name] = read_parameter(link, name, timeout=timeout, attempts=attempts)
    return values


def set_parameter(
    link: VehicleLink, name: str, value: float, *, timeout: float = 0.5, attempts: int = ATTEMPTS
) -> Parameter:
    """Set a parameter in the vehicle's own type for it. Returns what the vehicle reports then.

    Its error is not_taken if that is another value.
    """
    present = read_parameter(link, name, timeout=timeout, attempts=attempts)
    if present.value is None:
        return present
    wire = encode_value(value, present.type)

    def request(attempt: int) -> Message:
        status = link.status
        return mavlink.MAVLink_param_set_message(status.system, status.component, name.encode(), wire, present.type)

    answer = link.exchange(request, lambda message: _read(message, name), timeout=timeout, attempts=attempts)
    if answer is None or answer.value is None:
        return answer or Parameter(name, None, error=NO_ANSWER)
    taken = isclose(answer.value, value, rel_tol=1e-6, abs_tol=1e-9)
    return answer if taken else msgspec.structs.replace(answer, error="not_taken")


def _read(message: Message, name: str) -> Parameter | None:
    kind = message.get_type()
    if kind not in ("PARAM_VALUE", "PARAM_ERROR") or message.param_id != name:
        return None
    if kind == "PARAM_ERROR":
        return Parameter(name, None, error=enum_name("MAV_PARAM_ERROR", message.error, "MAV_PARAM_ERROR_"))
    return Parameter(name, decode_value(message.param_value, message.param_type), message.param_type)
