"""The setpoint message: SET_ATTITUDE_TARGET with body rates and thrust."""

from __future__ import annotations

from runtime.link.dialect import Message, mavlink

_RATES_AND_THRUST = mavlink.ATTITUDE_TARGET_TYPEMASK_ATTITUDE_IGNORE  # 128: body rates and thrust (docs/px4.md)


def rate_setpoint_message(
    address: tuple[int, int], rate_body: tuple[float, float, float], thrust: float, now: float
) -> Message:
    """SET_ATTITUDE_TARGET to a system and component, with finite body rates, FLU, rad/s, and thrust, 0..1, clipped.

    now: s, on our clock.
    """
    x, y, z = (float(value) for value in rate_body)
    return mavlink.MAVLink_set_attitude_target_message(
        int(now * 1e3) & 0xFFFFFFFF,
        *address,
        _RATES_AND_THRUST,
        (1.0, 0.0, 0.0, 0.0),
        x,
        -y,
        -z,
        min(1.0, max(0.0, float(thrust))),
    )
