"""Collective thrust in N to the 0..1 of SET_ATTITUDE_TARGET and back, corrected in flight.

The autopilot turns a thrust setpoint T into each motor's signal s by f s^2 + (1 - f) s = T, f its THR_MDL_FAC. The
vehicle's thrust is then thrust_max (c s^2 + (1 - c) s), c its file's thrust_curve. One factor, the effectiveness,
covers what both omit: a sagging battery, a wrong mass or constant.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from math import exp, hypot, inf, isfinite, nan, sqrt

import msgspec
import numpy as np

from dynamics import quaternion
from dynamics.arrays import Floats
from dynamics.vehicle import GRAVITY, Rotors

# The effectiveness by which a file that somebody weighed and measured is wrong at lift-off. Thrust goes with the square
# of the voltage: a full cell has 4.2 V and an empty one 3.4 V where constants are given for 3.7 V, factors of 1.29 and
# 0.84. A propeller of another make gives 20 % more or less, a battery or a load 25 % of mass. All three at their worst
# are 1.29 x 1.2 / 0.75 = 2.1 and 0.84 x 0.8 / 1.25 = 0.54, as independent errors 1.5 and 0.7.
MIN_FILE_ERROR, MAX_FILE_ERROR = 0.55, 1.65
PAST_STEP = 0.05  # s between the values that are kept
THRUST_CURVE = "THR_MDL_FAC"  # the autopilot's parameter f


def curve(signal: float, factor: float) -> float:
    """Thrust over maximum thrust at a motor signal, factor s^2 + (1 - factor) s. signal: 0..1."""
    return factor * signal * signal + (1.0 - factor) * signal


def curve_inverse(thrust: float, factor: float) -> float:
    """The motor signal that gives a thrust, 0..1 (PX4 control allocation, thrust model factor)."""
    if factor < 1e-6:
        return thrust
    linear = 1.0 - factor
    return (-linear + sqrt(linear * linear + 4.0 * factor * max(thrust, 0.0))) / (2.0 * factor)


def rotor_speed(signal: float, rotors: Rotors) -> float:
    """The speed that a motor signal of 0..1 commands by the vehicle file's thrust curve, rad/s."""
    return rotors.speed_max * sqrt(max(curve(signal, rotors.thrust_curve), 0.0))


@dataclass(frozen=True)
class ThrustMap:
    """From collective thrust to the autopilot's setpoint and back.

    thrust_max: of all rotors, N.
    vehicle_curve: c, the vehicle file's thrust_curve.
    autopilot_curve: f, the autopilot's THR_MDL_FAC.
    """

    thrust_max: float
    vehicle_curve: float
    autopilot_curve: float

    def setpoint(self, collective_thrust: float, effectiveness: float = 1.0) -> float:
        """The setpoint, 0..1, that gives a thrust. collective_thrust: N. effectiveness: see module."""
        share = min(max(collective_thrust / (self.thrust_max * effectiveness), 0.0), 1.0)
        return curve(curve_inverse(share, self.vehicle_curve), self.autopilot_curve)

    def collective_thrust(self, setpoint: float, effectiveness: float = 1.0) -> float:
        """The thrust that a setpoint of 0..1 gives, N: the inverse of `setpoint`."""
        signal = curve_inverse(min(max(setpoint, 0.0), 1.0), self.autopilot_curve)
        return self.thrust_max * effectiveness * curve(signal, self.vehicle_curve)


def specific_force_z(
    velocity_before: Floats,
    velocity_after: Floats,
    duration: float,
    attitude: Floats,
) -> float:
    """Specific force along body z from two velocities, for vehicles that send no accelerometer, m/s^2.

    velocities: (3,) m/s, world, `duration` s apart. attitude: (4,), in between.
    """
    acceleration = (velocity_after - velocity_before) / duration
    acceleration = acceleration + np.array([0.0, 0.0, GRAVITY])
    return float(quaternion.rotate_inverse(attitude, acceleration)[2])


def vertical(specific_force: Floats, attitude: Floats) -> float:
    """Vertical part of a specific force, m/s^2; of its part along body z where no other is measured, NaN without it.

    specific_force: (3,) m/s^2, body, NaN for an axis that is not measured. attitude: (4,).
    """
    if not isfinite(specific_force[2]):
        return nan
    if np.all(np.isfinite(specific_force)):
        return float(quaternion.rotate(attitude, specific_force)[2])
    return float(specific_force[2])


class EffectivenessSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The effectiveness filter's noise and limits.

    initial_deviation: standard deviation at the start.
    process_noise: standard deviation per sqrt(s).
    measurement_noise: standard deviation of the specific force, m/s^2.
    delay: s, pure delay from a setpoint to thrust.
    response_time: s, of the first-order response after it.
    timing: uncertainty of that response as a share of the thrust's change.
    speed: m/s at which aerodynamic forces double the noise.
    gate: standard deviations beyond which a measurement is rejected.
    patience: s of rejection after which the variance is reset.
    minimum, maximum: of the effectiveness.
    """

    initial_deviation: float = 0.15
    process_noise: float = 0.02
    measurement_noise: float = 1.5
    delay: float = 0.02
    response_time: float = 0.05
    timing: float = 0.5
    speed: float = 3.0
    gate: float = 3.0
    patience: float = 1.0
    minimum: float = msgspec.field(default=0.4, name="least")
    maximum: float = msgspec.field(default=MAX_FILE_ERROR, name="greatest")


class ThrustResponse:
    """The modelled thrust that follows the setpoints sent: a pure delay, then a first-order lag. Pure."""

    def __init__(self, settings: EffectivenessSettings | None = None) -> None:
        self._settings = settings or EffectivenessSettings()
        self._commands: deque[tuple[float, float]] = deque(maxlen=64)
        self.clear()

    def clear(self) -> None:
        """Forget all setpoints; thrust starts at the next one."""
        self.target = self.thrust = 0.0
        self._time: float | None = None
        self._commands.clear()

    def command(self, modelled_thrust: float, time: float) -> None:
        """Add a setpoint that was sent. modelled_thrust: its thrust at effectiveness 1, N. time: s."""
        if not self._commands and self._time is None:
            self.target = self.thrust = modelled_thrust
        self._commands.append((time + self._settings.delay, modelled_thrust))

    def advance(self, time: float) -> float:
        """The modelled thrust at a time, s, at effectiveness 1, N."""
        now = self._time if self._time is not None else time
        while self._commands and self._commands[0][0] <= time:
            at, target = self._commands.popleft()
            self._relax(max(at - now, 0.0))
            now = max(now, at)
            self.target = target
        self._relax(max(time - now, 0.0))
        self._time = max(now, time)
        return self.thrust

    def _relax(self, duration: float) -> None:
        self.thrust += (self.target - self.thrust) * (1 - exp(-duration / self._settings.response_time))


class ThrustLoss:
    """Whether thrust has gone for good: for a fifth of a second the specific force lacks more than shocks explain.

    Nothing that a vehicle meets takes specific force away for so long without holding it down, and neither does the
    ground. Wind that pushes against the thrust of a vehicle that leans into it pushes it sideways as well, and lost
    thrust does not. A filter's gate would reject it as a shock, and what flies would take it for a force from outside.
    """

    TIME = 0.2  # s
    SHARE = 0.15  # of the modelled thrust that may be missing
    DEVIATIONS = 3.0  # of a mean, by which noise may take it away
    MAX_FORCE = 1000.0  # m/s^2 that a sensor can show
    DRAG = 2.0  # m/s^2 per m/s of climb, which is no loss

    def __init__(self) -> None:
        self._samples: deque[tuple[float, ...]] = deque()

    def clear(self) -> None:
        """Forget all samples."""
        self._samples.clear()

    def update(
        self,
        time: float,
        specific_force: tuple[float, float, float],
        modelled: float,
        value: float,
        *,
        changing: float,
        climb: float,
    ) -> float:
        """The share of thrust that is left, 1 where none is lost.

        time: s. specific_force: body, m/s^2; NaN across the thrust where it is not measured. modelled: along body z,
        at effectiveness 1, m/s^2. value: the effectiveness. changing: thrust that is still to follow its setpoint,
        m/s^2. climb: along body z, m/s.
        """
        samples, doubt = self._samples, self.DRAG * max(climb, 0.0) + 0.5 * changing
        felt = (min(max(part, -self.MAX_FORCE), self.MAX_FORCE) if isfinite(part) else 0.0 for part in specific_force)
        samples.append((time, *felt, modelled, doubt))
        while samples[0][0] < time - self.TIME - 1e-6:
            samples.popleft()
        if time - samples[0][0] < 0.9 * self.TIME:
            return 1.0
        table = np.array(samples)[:, 1:]
        noise = sqrt(0.5 * float(np.mean(np.diff(table[:, 2]) ** 2)))
        for half in np.array_split(table, 2):  # a shock is over before both lack it
            across, along, axial, thrust, doubted = np.mean(half, axis=0).tolist()
            doubted += self.DEVIATIONS * noise / sqrt(len(half)) + hypot(across, along)
            if axial + doubted > (1.0 - self.SHARE) * value * thrust:
                return 1.0
        self.clear()
        return max(float(axial) / (value * float(thrust)), 0.0)


class EffectivenessEstimator:
    """Thrust per modelled thrust, a one-state Kalman filter on the specific force along body z.

    The quantity of PX4's hover thrust estimator (ZeroOrderHoverThrustEkf), but linear, because the measurement k F / m
    is linear in the effectiveness k. Pure: times are arguments.

    value: k. initial: the same at lift-off.
    across: mean specific force across the thrust over about PUSH_TIME, (2,) m/s^2. What pushes there, wind on a vehicle
        that leans into it, may take as much from the force along the thrust, which k then shows as lost.
    """

    PUSH_TIME = 0.5  # s
    SETTLING = 1.0  # s after a loss, in which the filter follows in a landing as well: a fifth of a second is noisy

    def __init__(self, mass: float, settings: EffectivenessSettings | None = None) -> None:
        """mass: kg, of the controller's model; an error of it is part of the effectiveness."""
        self._mass = mass
        self._settings = settings or EffectivenessSettings()
        self._response = ThrustResponse(self._settings)
        self._past: deque[tuple[float, float]] = deque(maxlen=64)
        self.start(1.0)

    def start(self, value: float) -> None:
        """Restart from a value, as at lift-off."""
        self._settled = -inf
        self._loss = ThrustLoss()
        self.across = np.zeros(2)
        self.value = self.initial = self._bounded(value)
        self.variance = self._settings.initial_deviation**2
        self.rejected = 0
        self._rejected_since: float | None = None
        self._time: float | None = None
        self._response.clear()
        self._past.clear()

    def earlier(self, duration: float) -> float:
        """The value some time before the last measurement, at the earliest the one at the start. duration: s."""
        if not self._past:
            return self.value
        end = self._past[-1][0] - duration
        return next((value for time, value in reversed(self._past) if time <= end), self._past[0][1])

    def command(self, modelled_thrust: float, time: float) -> None:
        """Add a setpoint that was sent. modelled_thrust: its thrust at effectiveness 1, N. time: s."""
        self._response.command(modelled_thrust, time)

    def thrust(self, time: float) -> float:
        """The collective thrust at a time, s, by the setpoints sent and the present effectiveness, N."""
        return self.value * self._response.advance(time)

    def measure(
        self,
        specific_force: float,
        time: float,
        speed: float = 0.0,
        *,
        climb: float = 0.0,
        sideways: tuple[float, float] = (0.0, 0.0),
        landing: bool = False,
    ) -> bool:
        """Take a specific force along body z, m/s^2, measured in flight. Returns whether it was used.

        speed: m/s. climb: velocity along body z, m/s. sideways: specific force along body x and y, m/s^2.
        landing: whether the ground may carry a part of the weight, which looks like more thrust; then only a loss of it
        counts, and what follows within a second.
        """
        settings = self._settings
        elapsed = 0.0 if self._time is None else min(max(time - self._time, 0.0), 0.5)
        self._time = time
        self.variance = min(self.variance + settings.process_noise**2 * elapsed, settings.initial_deviation**2)
        if isfinite(sideways[0]) and isfinite(sideways[1]):
            self.across += (1.0 - exp(-elapsed / self.PUSH_TIME)) * (sideways - self.across)
        # specific force at effectiveness 1: the measurement's derivative
        modelled = self._response.advance(time) / self._mass
        if not isfinite(specific_force) or modelled < 0.3 * GRAVITY:
            self._loss.clear()
            return False
        changing = abs(self._response.target - self._response.thrust) / self._mass
        force = (*sideways, specific_force)
        left = self._loss.update(time, force, modelled, self.value, changing=changing, climb=climb)
        if left < 1.0:
            self._restart(left * self.value, time)
            return True
        if landing and time > self._settled:
            return False
        uncertain_response = settings.timing * (self._response.target - self._response.thrust) / self._mass
        noise = settings.measurement_noise**2 * (1 + (speed / settings.speed) ** 2) ** 2 + uncertain_response**2
        innovation = specific_force - modelled * self.value
        innovation_variance = modelled**2 * self.variance + noise
        if abs(innovation) > settings.gate * sqrt(innovation_variance):
            self._reject(time)
            return False
        self._rejected_since = None
        gain = self.variance * modelled / innovation_variance
        self.value = self._bounded(self.value + gain * innovation)
        self.variance *= 1 - gain * modelled
        if not self._past or time - self._past[-1][0] >= PAST_STEP:
            self._past.append((time, self.value))
        return True

    def _restart(self, value: float, time: float) -> None:
        """Continue from a value that is as uncertain as at lift-off."""
        self.value, self.variance = self._bounded(value), self._settings.initial_deviation**2
        self._rejected_since = None
        self._settled = time + self.SETTLING
        self._past.append((time, self.value))

    def _reject(self, time: float) -> None:
        self.rejected += 1
        if self._rejected_since is None:
            self._rejected_since = time
        elif time - self._rejected_since > self._settings.patience:
            self.variance = self._settings.initial_deviation**2
            self._rejected_since = None

    def _bounded(self, value: float) -> float:
        return min(max(value, self._settings.minimum), self._settings.maximum)
