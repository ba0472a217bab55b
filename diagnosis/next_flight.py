"""The manoeuvre that would show an effect, or tell two apart."""

from __future__ import annotations

from collections.abc import Sequence

SHOWS = {
    "rotor_drag": "yaw spins while flying circles at 2 to 4 m/s",
    "linear_drag": "straight accelerations to top speed and back along both axes, level and vertical",
    "parasitic_drag": "straight accelerations to top speed and back along both axes",
    "rotational_damping": "fast rolls, pitches and yaw turns without travelling",
    "wind": "hover with the nose turned to four directions, and known drag in the vehicle file",
    "gust": "a minute of hover in one place",
    "ground_effect": "low passes between 0.1 and 1 m above flat ground",
    "wall_effect": "slow passes at several distances from each wall",
    "translational_lift": "level flight at several speeds",
    "axial_inflow": "fast climbs and descents without tilt",
    "blade_flapping": "aggressive horizontal accelerations along both axes",
    "rotor_gyroscopic": "fast rolls and pitches during strong yaw accelerations",
    "motor_lag": "quick steps in thrust and body rates",
    "battery_sag": "the same manoeuvre with a full and with a nearly empty battery",
    "weak_rotor": "thrust steps in hover, then the same with the payload moved",
    "rotor_cant": "thrust steps in hover and slow yaw turns",
    "thrust_constant": "fast rolls and pitches: a wrong thrust constant also shows in torque, a wrong mass does not",
    "torque_constant": "yaw steps in both directions",
    "inertia": "fast rolls, pitches and yaw steps",
    "mass": "fast rolls and pitches, and the vehicle on a scale",
    "centre_of_mass": "thrust steps in hover, then the same with swapped propellers",
    "slung_load": "a stop from 3 m/s, then hover while the load swings out",
    "imu_bias": "hover with the nose turned to four directions",
    "gyro_bias": "half a minute of quiet hover",
    "time_delay": "quick alternating rolls and pitches",
    "rotor_speed_fault": "thrust steps in hover with the motor commands logged beside the measured speeds",
}


def next_flight(apart: Sequence[str], unseen: Sequence[str]) -> str:
    """What to fly next. apart: effects that these flights cannot tell apart; unseen: effects not excited."""
    if len(apart) > 1:
        ways = "; ".join(dict.fromkeys(SHOWS.get(name, "more aggressive flight") for name in apart))
        return f"to tell {' from '.join(apart)}: {ways}"
    if unseen:
        return f"to see {unseen[0]}: {SHOWS.get(unseen[0], 'more aggressive flight')}"
    return "nothing is open; fly again after the next change of the vehicle"
