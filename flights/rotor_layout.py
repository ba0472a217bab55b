"""Where a vehicle's rotors are and how they turn, by the parameters that its autopilot logged."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from dynamics.arrays import Vector3
from dynamics.autopilot_frames import FRAMES, Frame, ardupilot_frame
from flights.readers.px4_rotors import QUADROTOR, rotor_order

GENERIC_ARM = 0.15  # m, CA_ROTORn_PX and PY of PX4's generic airframes
DEFAULT_RATIO = 0.05  # CA_ROTORn_KM that PX4 gives every rotor
MAX_TILT = math.radians(1.0)  # of a rotor's axis that counts as upright


@dataclass(frozen=True)
class RotorLayout:
    """Rotors in the order in which logs are read.

    autopilot: "PX4" or "ArduPilot".
    position: body FLU, m, or in units of the arm where `in_metres` is false.
    spin: sign of each rotor's reaction torque about body z.
    motor: the autopilot's number of each rotor's motor, from 1.
    in_metres: whether the parameters state lengths, and not a frame's shape alone.
    torque_ratio: torque over thrust by the parameters, m; None where there is none or PX4's default.
    thrust_curve: share of the thrust that the autopilot takes to go with the square of the signal; None: not stated.
    hover: the autopilot's hover thrust of 0 to 1; None where it is not stated.
    origin: the parameters behind it.
    notes: to the user.
    is_given: whether the user states it, and no parameters.
    """

    autopilot: str
    position: tuple[Vector3, ...]
    spin: tuple[int, ...]
    motor: tuple[int, ...]
    in_metres: bool
    torque_ratio: float | None
    thrust_curve: float | None
    hover: float | None
    origin: str
    notes: tuple[str, ...] = ()
    is_given: bool = False

    @property
    def arm(self) -> float:
        """Distance of the outermost rotor from the centre, in the unit of the positions."""
        return max(math.hypot(x, y) for x, y, _ in self.position)

    def scaled(self, arm: float) -> tuple[Vector3, ...]:
        """The positions with the outermost rotor at a distance from the centre, m."""
        factor = arm / self.arm
        return tuple((x * factor, y * factor, z * factor) for x, y, z in self.position)


def states_rotors(parameters: Mapping[str, float]) -> bool:
    """Whether parameters state a layout; PX4's usual quadrotor, assumed where they state none, is not stated."""
    return rotor_layout(parameters) is not None


def rotor_layout(parameters: Mapping[str, float], vehicle_type: int | None = None) -> RotorLayout | None:
    """The layout that parameters state, None where they state none. vehicle_type: MAV_TYPE."""
    if parameters.get("CA_ROTOR_COUNT", 0) >= 1:
        return _px4(parameters, vehicle_type)
    if "FRAME_CLASS" in parameters:
        return _ardupilot(parameters)
    is_px4 = any(name in parameters for name in ("SYS_AUTOSTART", "MC_ROLLRATE_P"))
    if is_px4 and vehicle_type == QUADROTOR:
        notes = ("the log states no geometry: PX4's usual quadrotor X is assumed",)
        return _of_frame(FRAMES["quad_x"], "PX4", parameters, "MAV_TYPE", notes)
    return None


def _px4(parameters: Mapping[str, float], vehicle_type: int | None) -> RotorLayout:
    count = int(parameters["CA_ROTOR_COUNT"])
    order = rotor_order(parameters, vehicle_type)[0] or tuple(range(count))

    def of(motor: int, name: str) -> float:
        return float(f"{parameters.get(f'CA_ROTOR{motor}_{name}', 0.0):.6g}")  # logged in single precision

    position = tuple((of(m, "PX"), -of(m, "PY") + 0.0, -of(m, "PZ") + 0.0) for m in order)
    ratios = [of(m, "KM") for m in order]
    torque_ratio = sum(map(abs, ratios)) / count
    return RotorLayout(
        autopilot="PX4",
        position=position,
        spin=tuple(-1 if ratio > 0 else 1 for ratio in ratios),  # KM > 0 turns counter-clockwise
        motor=tuple(m + 1 for m in order),
        in_metres=not _is_shape(position),
        torque_ratio=None if math.isclose(torque_ratio, DEFAULT_RATIO, rel_tol=1e-3) else torque_ratio,
        thrust_curve=parameters.get("THR_MDL_FAC"),
        hover=parameters.get("MPC_THR_HOVER"),
        origin="CA_ROTORn_PX, PY, PZ and KM",
        notes=tuple(_px4_notes(parameters, position, order)),
    )


def _px4_notes(parameters: Mapping[str, float], position: tuple[Vector3, ...], order: tuple[int, ...]) -> Iterator[str]:
    if _is_shape(position):
        yield "CA_ROTORn_PX and PY are in units of the arm, not m: they state the shape alone"
    elif all(math.isclose(abs(c), GENERIC_ARM, rel_tol=1e-3) for p in position for c in p[:2]):
        yield f"CA_ROTORn_PX and PY are those of PX4's generic airframe, {GENERIC_ARM} m: measure the arm and give it"
    for motor in order:
        x, y, z = (parameters.get(f"CA_ROTOR{motor}_A{axis}", at) for axis, at in (("X", 0.0), ("Y", 0.0), ("Z", -1.0)))
        tilt = math.atan2(math.hypot(x, y), -z)
        if tilt > MAX_TILT:
            yield (
                f"motor {motor + 1} is tilted by {math.degrees(tilt):.0f} degrees (CA_ROTOR{motor}_AX, AY, AZ): the "
                "nominal model has upright rotors, and an effect rotor_cant for one that is not"
            )


def _is_shape(position: tuple[Vector3, ...]) -> bool:
    """Whether positions are in units of the arm: coordinates or distances of exactly 1."""
    largest = max(max(abs(x), abs(y)) for x, y, _ in position)
    distances = [math.hypot(x, y) for x, y, _ in position]
    return math.isclose(largest, 1.0, rel_tol=1e-3) or all(math.isclose(d, 1.0, rel_tol=1e-3) for d in distances)


def _ardupilot(parameters: Mapping[str, float]) -> RotorLayout | None:
    numbers = int(parameters["FRAME_CLASS"]), int(parameters.get("FRAME_TYPE", -1))
    name = ardupilot_frame(*numbers)
    if name is None:
        return None
    origin = f"FRAME_CLASS {numbers[0]} and FRAME_TYPE {numbers[1]}, {name.replace('_', ' ')}"
    return _of_frame(FRAMES[name], "ArduPilot", parameters, origin, ())


def _of_frame(
    frame: Frame, autopilot: str, parameters: Mapping[str, float], origin: str, notes: tuple[str, ...]
) -> RotorLayout:
    curve, hover = ("THR_MDL_FAC", "MPC_THR_HOVER") if autopilot == "PX4" else ("MOT_THST_EXPO", "MOT_THST_HOVER")
    return RotorLayout(
        autopilot=autopilot,
        position=frame.direction,
        spin=frame.spin,
        motor=frame.motor,
        in_metres=False,
        torque_ratio=None,
        thrust_curve=parameters.get(curve),
        hover=parameters.get(hover),
        origin=origin,
        notes=notes,
    )
