"""[autopilot] of a vehicle file: the gains of the autopilot's body-rate loop, which no correction of the model changes.

Without the table the gains are assumed to suit the motors of the file (`dynamics.rate_loop`); over a link they are read
from the autopilot itself.
"""

from __future__ import annotations

from collections.abc import Mapping

import msgspec

from dynamics.arrays import Vector3
from dynamics.errors import RequestError

AXES = ("ROLL", "PITCH", "YAW")
CUTOFFS = ("IMU_GYRO_CUTOFF", "MC_YAW_TQ_CUTOFF")
GAINS = tuple(f"MC_{axis}RATE_{part}" for axis in AXES for part in ("P", "K"))
PARAMETERS = (*GAINS, *CUTOFFS)  # of PX4; the proportional gains are there in every version
NO_FILTER = 1000.0  # Hz


class AutopilotSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Facts of the autopilot, under PX4's units.

    rate_gain: normalised torque about body x, y, z for 1 rad/s of error: MC_{ROLL,PITCH,YAW}RATE_K times _P.
    gyro_cutoff: IMU_GYRO_CUTOFF, Hz.
    yaw_torque_cutoff: MC_YAW_TQ_CUTOFF, Hz.
    """

    rate_gain: Vector3
    gyro_cutoff: float = 40.0
    yaw_torque_cutoff: float = 2.0

    @classmethod
    def from_parameters(cls, values: Mapping[str, float]) -> AutopilotSettings | None:
        """The gains that PX4's parameters give, by name; None without one of the proportional gains.

        Raises RequestError for gains that hold no body rate.
        """
        if any(f"MC_{axis}RATE_P" not in values for axis in AXES):
            return None
        roll, pitch, yaw = (values[f"MC_{axis}RATE_P"] * values.get(f"MC_{axis}RATE_K", 1.0) for axis in AXES)
        gyro, torque = (min(values.get(name, 0.0) or NO_FILTER, NO_FILTER) for name in CUTOFFS)  # 0 Hz: switched off
        return cls((roll, pitch, yaw), gyro, torque)

    def __post_init__(self) -> None:
        """Refuse gains that hold no body rate."""
        roll, pitch, yaw = self.rate_gain
        if not (0 < roll < 100 and 0 < pitch < 100 and 0 <= yaw < 100):
            raise RequestError(
                f"autopilot.rate_gain = {list(self.rate_gain)}: give the normalised torque for 1 rad/s about x, y, z, "
                "above 0 (yaw may be 0) and below 100: PX4's MC_ROLLRATE_K x MC_ROLLRATE_P and so on."
            )
        for name in ("gyro_cutoff", "yaw_torque_cutoff"):
            if not 0 < getattr(self, name) <= 1000:
                raise RequestError(f"autopilot.{name} = {getattr(self, name):g}: give above 0 to 1000 Hz.")
