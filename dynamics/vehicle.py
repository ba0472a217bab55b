"""The vehicle: its body, rotors, limits and identified effects.

Plain frozen data, checked for physical sense on creation; `dynamics.vehicle_file` reads and writes it.
"""

from __future__ import annotations

import math
from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta

from dynamics.arrays import Floats, Vector3
from dynamics.autopilot_settings import AutopilotSettings
from dynamics.controller_settings import ControllerSettings
from dynamics.effect_source import EffectFile
from dynamics.errors import RequestError

GRAVITY = 9.81  # m/s^2
Positive = Annotated[float, Meta(gt=0)]
NonNegative = Annotated[float, Meta(ge=0)]


class Body(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The rigid body.

    mass: kg.
    inertia: diagonal about body x, y, z, kg m^2.
    centre_of_mass: body FLU, m.
    """

    mass: Positive
    inertia: tuple[Positive, Positive, Positive]
    centre_of_mass: Vector3 = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        """Refuse an inertia that no distribution of mass can have."""
        largest = max(self.inertia)
        if largest > sum(self.inertia) - largest:
            raise RequestError(
                f"impossible inertia {list(self.inertia)} kg m^2: no moment of a solid body may exceed the sum of the "
                "other two. Check the order (xx, yy, zz) and the units (kg m^2)."
            )


class Rotors(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The rotors, in the order of the input vector u.

    position: body FLU, m, one row a rotor.
    spin: sign of the reaction torque about body z.
    thrust_constant: k_f, N s^2/rad^2.
    torque_constant: k_tau, N m s^2/rad^2.
    speed_min, speed_max: rad/s.
    radius: propeller radius, m.
    thrust_curve: c in thrust/thrust_max = c s^2 + (1 - c) s for a motor signal s of 0 to 1 (1: speed follows the
        signal, 0: thrust does, as in PX4's SIH).
    motor: the autopilot's number of each rotor's motor, from 1; for people.
    """

    position: tuple[Vector3, ...]
    spin: tuple[int, ...]
    thrust_constant: Positive
    torque_constant: NonNegative
    speed_max: Positive
    speed_min: NonNegative = 0.0
    radius: Positive | None = None
    thrust_curve: Annotated[float, Meta(ge=0, le=1)] = 1.0
    motor: tuple[Annotated[int, Meta(ge=1)], ...] = ()

    def __post_init__(self) -> None:
        """Refuse layouts that cannot produce thrust, roll, pitch and yaw independently."""
        count = len(self.position)
        if len(self.spin) != count:
            raise RequestError(f"{count} rotor positions but {len(self.spin)} spin signs: give one of each per rotor.")
        if (self.motor and sorted(set(self.motor)) != sorted(self.motor)) or len(self.motor) not in (0, count):
            raise RequestError(f"rotor motor {list(self.motor)}: give {count} different numbers, or leave it out.")
        if any(sign not in (-1, 1) for sign in self.spin):
            raise RequestError(f"rotor spin {list(self.spin)}: each must be 1 or -1.")
        if self.speed_min >= self.speed_max:
            raise RequestError(f"rotor speed_min {self.speed_min} is not below speed_max {self.speed_max} (rad/s).")
        if count % 2 == 0 and sum(self.spin) != 0:
            raise RequestError(
                f"rotor spin {list(self.spin)} sums to {sum(self.spin)}: with {count} rotors the reaction torques must "
                "cancel in hover. Half of the rotors must turn each way; the paper's quadrotor has [1, -1, 1, -1]."
            )
        independent = 4 if self.torque_constant > 0 else 3  # without reaction torque nothing yaws
        if count < independent or np.linalg.matrix_rank(self.allocation) < independent:
            raise RequestError(
                f"rotor spin {list(self.spin)} at positions {[list(p) for p in self.position]} cannot command thrust, "
                "roll, pitch and yaw independently. A quadrotor's diagonally opposite rotors turn the same way."
            )

    @property
    def count(self) -> int:
        """Number of rotors."""
        return len(self.position)

    @property
    def allocation(self) -> Floats:
        """Matrix from squared rotor speeds to (thrust, torque x, y, z) (PI-TCN eq. 2). Returns (4, count).

        Torques are about the origin of the rotors' positions; about a centre of mass c elsewhere they are less by
        c x (0, 0, thrust), which the flight model takes into account.
        """
        position = np.array(self.position)
        force = np.full(self.count, self.thrust_constant)
        yaw = self.torque_constant * np.array(self.spin)
        return np.stack([force, force * position[:, 1], -force * position[:, 0], yaw])

    @property
    def thrust_max(self) -> float:
        """Thrust of all rotors at full speed, N."""
        return self.count * self.thrust_constant * self.speed_max**2

    @property
    def disc_radius(self) -> float:
        """Propeller radius, m; where the file has none, 0.45 of the smallest distance between two rotors."""
        if self.radius is not None:
            return self.radius
        position = np.array(self.position)
        gaps = np.linalg.norm(position[:, None] - position[None], axis=-1)
        return 0.45 * float(np.min(gaps[gaps > 0]))


class Limits(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Limits of flight.

    rate: rad/s about body x, y, z.
    thrust: minimum and maximum collective thrust, N; None for what the rotors can do.
    speed: m/s.
    box: lower and upper corner of the allowed positions, world ENU, m.
    """

    rate: tuple[Positive, Positive, Positive] = (6.0, 6.0, 3.0)
    thrust: tuple[NonNegative, Positive] | None = None
    speed: Positive = 20.0
    box: tuple[Vector3, Vector3] | None = None

    def __post_init__(self) -> None:
        """Refuse empty ranges."""
        if self.thrust is not None and self.thrust[0] >= self.thrust[1]:
            raise RequestError(f"limits.thrust {list(self.thrust)} N is empty: give the minimum, then the maximum.")
        if self.box is not None and any(low >= high for low, high in zip(*self.box, strict=True)):
            raise RequestError(f"limits.box {self.box} m is empty: give the lower corner, then the upper corner.")


class EffectUse(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """An effect on a vehicle.

    name: in the catalogue.
    parameters: its values; those left out are usual ones.
    rotor: of an effect of a single rotor.
    """

    name: str
    parameters: dict[str, float] = msgspec.field(default_factory=dict)
    rotor: int | None = None

    @property
    def label(self) -> str:
        """The name, with the rotor of an effect of one rotor: "weak_rotor[1]"."""
        return self.name if self.rotor is None else f"{self.name}[{self.rotor}]"


class HistoryEntry(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One line of a vehicle file's history: what was added, from which flights, and the errors before and after."""

    date: str
    action: str
    flights: tuple[str, ...] = ()
    before: dict[str, float] = msgspec.field(default_factory=dict)
    after: dict[str, float] = msgspec.field(default_factory=dict)
    command: str = ""


class Vehicle(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A vehicle file's content.

    autopilot: gains of its rate loop; None for gains that suit the motors of this file.
    effects: the identified model's, on top of the nominal model.
    effect_files: Python files with effects of one's own that it may name; a vehicle file has names relative to it.
    history: how the effects were identified, oldest entry first.
    source: where the numbers come from, free text.
    """

    name: str
    body: Body
    rotors: Rotors
    limits: Limits = Limits()
    controller: ControllerSettings = ControllerSettings()
    autopilot: AutopilotSettings | None = None
    effects: tuple[EffectUse, ...] = ()
    history: tuple[HistoryEntry, ...] = ()
    source: str = ""
    effect_files: tuple[EffectFile, ...] = ()

    def __post_init__(self) -> None:
        """Refuse a vehicle that cannot lift itself: usually a constant is in the wrong unit."""
        if self.rotors.thrust_max <= self.weight:
            raise RequestError(
                f"{self.name}: all rotors at speed_max give {self.rotors.thrust_max:.3g} N, the weight is "
                f"{self.weight:.3g} N. Check thrust_constant (N s^2/rad^2), speed_max (rad/s, not rpm) and mass (kg)."
            )

    @property
    def weight(self) -> float:
        """Weight, N."""
        return self.body.mass * GRAVITY

    @property
    def hover_speed(self) -> float:
        """Rotor speed that carries the weight when all rotors share it, rad/s."""
        return math.sqrt(self.weight / (self.rotors.count * self.rotors.thrust_constant))

    @property
    def thrust_limits(self) -> tuple[float, float]:
        """Minimum and maximum collective thrust, N: the file's limits, or what the rotors can do."""
        thrust_min = self.rotors.count * self.rotors.thrust_constant * self.rotors.speed_min**2
        return self.limits.thrust or (thrust_min, self.rotors.thrust_max)

    def with_effects(self, *uses: EffectUse) -> Vehicle:
        """Vehicle with further effects."""
        return msgspec.structs.replace(self, effects=self.effects + uses)

    def with_effect_replaced(self, use: EffectUse) -> Vehicle:
        """Vehicle with an effect in place of what it had of the same name and rotor."""
        others = tuple(own for own in self.effects if (own.name, own.rotor) != (use.name, use.rotor))
        return msgspec.structs.replace(self, effects=(*others, use))
