"""The flying vehicle: plant, inner loop, sensors, battery and the modes that fly by themselves.

Simulated time advances in steps of 1 ms, and every step has its own random numbers: a flight depends on the seed and on
when setpoints arrive, not on how the time is divided into calls. Pure: no clock, no link.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from dynamics import quaternion
from dynamics.allocation import mixer
from dynamics.arrays import Floats
from dynamics.effect import Effect
from dynamics.effects import CATALOGUE
from dynamics.errors import RequestError
from dynamics.state import ATTITUDE, POSITION, RATE, RIGID_BODY_STATES, VELOCITY
from dynamics.vehicle import GRAVITY, EffectUse
from dynamics.vehicle import Vehicle as VehicleFile
from sitl_mock.vehicle import ground
from sitl_mock.vehicle.battery import BatteryPack, open_circuit_voltage, usual_battery
from sitl_mock.vehicle.estimator import NO_AIDING_TIME, Drift, Wander, at_rest
from sitl_mock.vehicle.ground import Ground
from sitl_mock.vehicle.land_detector import LandDetector
from sitl_mock.vehicle.plant import DT, Plant, build_plant
from sitl_mock.vehicle.position_control import PositionControl
from sitl_mock.vehicle.sensors import SensorErrors, quantised
from sitl_mock.vehicle.step_loop import StepLoop
from sitl_mock.vehicle.tuning import default_tuning
from sitl_mock.vehicle.vehicle_interface import BatteryState, ControlSetpoint, ImuSample, MotionState, Tuning

NOISE_BLOCK = 512  # steps whose random numbers are drawn at once
DRIFT_SEED = 1  # keeps the drifting errors' random numbers apart from all others
SUPERVISION = 8  # steps between two updates of position control and land detector
POSITION_KINDS = ("hold", "land", "rtl")
LEVEL, NOTHING = [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0]


@dataclass(frozen=True)
class VehicleOptions:
    """The vehicle's surroundings, sensors and battery.

    sensors: their errors.
    wander: slower errors of the estimate.
    start_height_error: of the estimate, m; None for one by chance, of the size that `wander` has.
    ground: its kind, slope and motion.
    ground_height: m, at the origin.
    position: of the start, east and north, m.
    yaw: of the start, rad from east.
    rotor_noise: standard deviation of a rotor's speed over its speed, white.
    battery: None for one that suits the vehicle.
    rotor_speed_fault: (rotor, factor) of measured speeds; 0 for a dead sensor.
    """

    sensors: SensorErrors = dataclasses.field(default_factory=SensorErrors)
    wander: Wander = dataclasses.field(default_factory=Wander)
    start_height_error: float | None = None
    ground: Ground = dataclasses.field(default_factory=Ground)
    ground_height: float = 0.0
    position: tuple[float, float] = (0.0, 0.0)
    yaw: float = 0.0
    rotor_noise: float = 0.002
    battery: BatteryPack | None = None
    rotor_speed_fault: tuple[tuple[int, float], ...] = ()


class SimulatedVehicle:
    """A vehicle on the ground, disarmed, at simulated time 0.

    effects: hidden from the vehicle file.
    tuning: None for gains derived from the vehicle.
    catalogue: the effects that may be named.

    Raises RequestError when there is no C compiler.
    """

    def __init__(
        self,
        vehicle: VehicleFile,
        *,
        effects: Sequence[EffectUse] = (),
        options: VehicleOptions | None = None,
        tuning: Tuning | None = None,
        seed: int = 0,
        catalogue: Mapping[str, Effect] = CATALOGUE,
    ) -> None:
        self.vehicle = vehicle
        self.options = options or VehicleOptions()
        self.plant: Plant = build_plant(vehicle, effects, catalogue)
        self._random = np.random.default_rng(seed)
        drifting = np.random.default_rng((seed, DRIFT_SEED))
        self._drift = Drift(self.options.wander, drifting, self.options.start_height_error)
        self._loop = StepLoop(self.plant)
        self._records = self.plant.record.views(self._loop.records)
        self._command_parts = self.plant.command.views(self._loop.command)
        self._armed, self._landed = self._command_parts["armed"], self._command_parts["landed"]
        self._constants = self.plant.constants.views(self._loop.constants)
        self._noise = np.empty((NOISE_BLOCK, self.plant.noise.size))
        noise = self.plant.noise.views(self._noise)
        self._inertial_noise = noise["gyro"], noise["accelerometer"]
        self._battery = self.options.battery or usual_battery(vehicle)
        self._step = 0
        self._due = 0.0
        self._last: tuple[ControlSetpoint | None, bool] = (None, False)
        self._thrust = 0.0
        self._gnss_lost_at = math.inf
        values = self.plant.model.parameter_values
        read = self.plant.model.measure(0, 0, 0, values, 0)
        pose, attitude, rotor = (float(read[place]) for place in (3, 4, 7))
        ages = (max(round(age / DT), 0) for age in (pose, pose + attitude, rotor))
        self._pose_age, self._attitude_age, self._rotor_age = ages  # steps
        self.land_detector = LandDetector()
        self._set_constants()
        self._set_state(drifting)
        self.tuning = tuning or default_tuning(vehicle, effects, catalogue)
        self._position_control = PositionControl(self.truth.position_world, self.tuning)
        self.tune(self.tuning)

    def tune(self, tuning: Tuning) -> None:
        """Use other inner-loop parameters from now on."""
        self.tuning = tuning
        self._position_control.tuning = tuning
        for field in dataclasses.fields(tuning):
            if field.name in self._constants:
                self._constants[field.name][:] = getattr(tuning, field.name)

    def advance(self, setpoint: ControlSetpoint, armed: bool, duration: float) -> None:
        """Simulate a duration (s) under a setpoint; rotors stand still when not armed."""
        self._due += duration
        end = round(self._due / DT)
        if setpoint is not self._last[0] or armed != self._last[1]:
            self._follow(setpoint, armed)
        while self._step < end:
            if self._step % SUPERVISION == 0:
                self._supervise(setpoint, armed)
                self._move_ground()
            if self._step % NOISE_BLOCK == 0:
                self._draw()
            steps = min(end, *(self._step // n * n + n for n in (SUPERVISION, NOISE_BLOCK))) - self._step
            self._loop.run(steps, self._step + 1, self._noise, self._step % NOISE_BLOCK)
            self._step += steps

    def _draw(self) -> None:
        """The random numbers of the next block of steps, and how far the drifting errors go in it."""
        self._random.standard_normal(out=self._noise)
        held = max(1, round(self.options.sensors.sample_period / DT))
        if held > 1:
            for part in self._inertial_noise:
                part[:] = np.repeat(part[::held], held, axis=0)[:NOISE_BLOCK]
        before = self._drift.offset
        self._drift.advance(NOISE_BLOCK * DT)
        self._constants["drift"][:] = (self._drift.offset - before) / (NOISE_BLOCK * DT)

    def _move_ground(self) -> None:
        if self.options.ground.moves:
            self._constants["ground_velocity"][:] = self.options.ground.velocity(self.time)

    # measurements and state

    @property
    def time(self) -> float:
        """Simulated time, s."""
        return self._step * DT

    @property
    def truth(self) -> MotionState:
        """The plant's state."""
        return self._motion("truth", 0)

    @property
    def plant_state(self) -> Floats:
        """The flight model's whole state, hidden states of its effects included, in the model's order."""
        return self._loop.state[self.plant.state.places["plant"]].copy()

    @property
    def estimate(self) -> MotionState:
        """The estimator's output: as old as its delay, with its errors, rates from the filtered gyro."""
        oldest = self._oldest
        delay, period = (
            round(value / DT) for value in (self.options.sensors.delay, self.options.sensors.estimate_period)
        )
        age = min(delay + (self._step - delay) % max(period, 1), oldest)

        def aged(more: int) -> MotionState:
            return self._motion("estimate", min(age + more, oldest))

        stamped, pose, turned = aged(0), aged(self._pose_age), aged(self._attitude_age)
        return dataclasses.replace(pose, time=stamped.time, rate_body=stamped.rate_body, attitude=turned.attitude)

    @property
    def estimate_now(self) -> MotionState:
        """The estimate before any delay: what the autopilot itself flies by."""
        return self._motion("estimate", 0)

    @property
    def imu(self) -> ImuSample:
        """The newest inertial measurement at the centre of mass, averaged as PX4's delta velocities and angles are.

        It is free of the biases that the estimator sees.
        """
        count = max(1, round(self.options.sensors.imu_average / DT))
        if self.options.sensors.sample_period > DT:
            mean = 0.5 * (self._mean_inertial(0, 1) + self._mean_inertial(count, 1))
        else:
            mean = self._mean_inertial(0, count)
        mean = mean - self._drift.bias
        return ImuSample(self.time, mean[0:3], mean[3:6])

    def _mean_inertial(self, age: int, count: int) -> Floats:
        """(6,) specific force and rates as measured, averaged over so many steps until so many steps ago."""
        longest = len(self._loop.records) - 1
        age = min(age, longest - 1)
        count = min(count, longest - age)
        newest, oldest = self._row(age), self._row(age + count)
        integrals = self._records["force_integral"], self._records["gyro_integral"]
        parts = [(integral[newest] - integral[oldest]) / (count * DT) for integral in integrals]
        return np.concatenate(parts)

    @property
    def rotor_speed(self) -> Floats:
        """(rotors,) measured, rad/s, in the vehicle file's order."""
        return self._read_speed(self._of_rotors("rotor_speed_measured"))

    def mean_rotor_speed(self, duration: float) -> Floats:
        """(rotors,) measured over the last `duration` s, as a sensor that counts turns does, rad/s."""
        count = min(max(1, round(duration / DT)), len(self._loop.records) - 1)
        ages = np.minimum(np.arange(count) + self._rotor_age, self._oldest)
        mean = self._records["rotor_speed"][[self._row(age) for age in ages]].mean(axis=0)
        now, measured = self._of_rotors("rotor_speed"), self._of_rotors("rotor_speed_measured")
        turning = now > 1.0  # rad/s; the error of the newest reading is relative to a speed
        return self._read_speed(np.where(turning, measured * mean / np.where(turning, now, 1.0), measured))

    def _read_speed(self, measured: Floats) -> Floats:
        for rotor, factor in self.options.rotor_speed_fault:
            measured[rotor] *= factor
        return np.maximum(quantised(measured, self.options.sensors.rotor_speed_step), 0.0)

    @property
    def true_rotor_speed(self) -> Floats:
        """(rotors,) rad/s, without measurement errors."""
        return self._newest("rotor_speed")

    @property
    def motor_signal(self) -> Floats:
        """(rotors,) 0..1, in the vehicle file's order."""
        return self._newest("motor_signal")

    @property
    def rotor_position(self) -> Floats:
        """(rotors, 3) m, body FLU."""
        return np.array(self.vehicle.rotors.position)

    @property
    def battery(self) -> BatteryState:
        """The battery now."""
        voltage, current, charge = (float(self._newest(name)[0]) for name in ("voltage", "current", "charge"))
        return BatteryState(voltage, current, charge)

    @property
    def on_ground(self) -> bool:
        """Whether the land detector has detected a landing."""
        return self.land_detector.landed

    def change(self, values: Mapping[str, float]) -> None:
        """Change constants of the flight model from now on, by name: {"weak_rotor[2].loss": 0.15}.

        Raises RequestError for a name that the model does not have.
        """
        self.require(values)
        names = self.plant.model.parameter_names
        for name, value in values.items():
            self._constants["model"][names.index(name)] = value

    def require(self, names: Iterable[str]) -> None:
        """Raises RequestError for the name of a constant that the flight model does not have."""
        for name in names:
            if name not in (there := self.plant.model.parameter_names):
                raise RequestError(
                    f"{name} is not in the vehicle's model, so that it cannot change in flight: give the effect with "
                    f"the value that it begins with. The model has {', '.join(there)}."
                )

    def use_gnss(self, available: bool) -> None:
        """Take satellite navigation from the estimator, or give it back: then it resets what has drifted off."""
        self._gnss_lost_at = math.inf if available else self.time
        if not available:
            self._drift.lose_gnss()
            return
        self._drift.regain_gnss()
        self._constants["drift"][:] = 0.0
        self._loop.state[self.plant.state.places["offset"]] = self._drift.offset

    @property
    def has_position(self) -> bool:
        """Whether the estimator calls its horizontal position and velocity valid: until 5 s without satellites."""
        return self.time - self._gnss_lost_at < NO_AIDING_TIME

    @property
    def clearance(self) -> float:
        """Distance of the feet from the ground in a level vehicle that stands on it: 0, in the air more, m."""
        point = self._loop.state[self.plant.state.places["ground_point"]]
        height = float(self.options.ground.normal @ (self.truth.position_world - point))
        return height - ground.leg_height(self.vehicle) + ground.SINKAGE

    def hold(self, held: bool) -> None:
        """Let a hand hold the vehicle where it is, or let go of it."""
        self._constants["held"][:] = held
        self._constants["held_at"][:] = self.truth.position_world

    def knock(self, rate_body: Floats) -> None:
        """Turn the vehicle by a blow. rate_body: (3,) rad/s that it adds."""
        place = self.plant.state.places["plant"].start
        self._loop.state[place + RATE.start : place + RATE.stop] += rate_body

    @property
    def ground_force(self) -> float:
        """Share of the weight that the ground carries now."""
        return float(self._newest("ground_force")[0]) / GRAVITY

    # inside

    def _row(self, age: int) -> int:
        return (self._step - age) % self._loop.records.shape[0]

    def _newest(self, name: str) -> Floats:
        part: Floats = self._records[name][self._row(0)].copy()
        return part

    @property
    def _oldest(self) -> int:
        """Age of the oldest record, steps."""
        return min(self._step, len(self._loop.records) - 1)

    def _of_rotors(self, name: str) -> Floats:
        """Readings of the rotors' sensors: as old as these are."""
        part: Floats = self._records[name][self._row(min(self._rotor_age, self._oldest))].copy()
        return part

    def _motion(self, name: str, age: int) -> MotionState:
        row = self._records[name][self._row(age)].copy()
        return MotionState((self._step - age) * DT, row[POSITION], row[VELOCITY], row[ATTITUDE], row[RATE])

    def _set_constants(self) -> None:
        vehicle, model = self.vehicle, self.plant.model
        rotors, battery = vehicle.rotors, self._battery
        mix = mixer(vehicle)
        constants = {
            "model": model.parameter_values,
            "mixer": mix,
            "unmixer": np.linalg.pinv(mix),
            "feet": ground.contact_points(vehicle) - self.plant.model.centre_of_mass[:, None],
            "mass_over_inertia": vehicle.body.mass / np.array(vehicle.body.inertia),
            "ground_normal": self.options.ground.normal,
            "ground_rights": self.options.ground.kind != "sih",
            "leg_height": ground.leg_height(vehicle),
            "speed_min": rotors.speed_min,
            "speed_max": rotors.speed_max,
            "thrust_curve": rotors.thrust_curve,
            "torque_constant": rotors.torque_constant,
            "rotor_noise": self.options.rotor_noise,
            "cells": battery.cells,
            "capacity": battery.capacity,
            "resistance": battery.resistance,
            "nominal_voltage": battery.nominal_voltage,
            **self.options.sensors.constants(self._random),
            **self.options.wander.constants(),
        }
        self._loop.constants[:] = self.plant.constants.fill(constants)

    def _set_state(self, random: np.random.Generator) -> None:
        model = self.plant.model
        east, north = self.options.position
        surface = self.options.ground
        attitude = surface.standing(self.options.yaw)
        centre = self.plant.model.centre_of_mass
        foot = np.array(
            [east, north, self.options.ground_height - (surface.normal[:2] @ [east, north]) / surface.normal[2]]
        )
        legs = surface.normal * (ground.leg_height(self.vehicle) - ground.SINKAGE)
        position = foot + legs + quaternion.rotate(attitude, centre)
        velocity = surface.velocity(0.0)
        x = model.initial_state(np.concatenate([position, velocity, attitude, np.zeros(3)]))
        for place in model.rotor_speed_places:
            x[place] = 0.0
        voltage = self._battery.cells * float(open_circuit_voltage(self._battery.charge))
        wander, rate = at_rest(self.options.wander, random)
        errors = {"wander": wander, "wander_rate": rate, "offset": self._drift.offset}
        state = {"plant": x, "charge": self._battery.charge, "voltage": voltage, "ground_point": foot, **errors}
        self._loop.state[:] = self.plant.state.fill(state)
        error = wander + self._drift.offset
        turned = quaternion.multiply(quaternion.exponential(error[6:9]), attitude)
        record = {
            "truth": x[:RIGID_BODY_STATES],
            "estimate": np.concatenate([position + error[0:3], velocity + error[3:6], turned, np.zeros(3)]),
            "charge": self._battery.charge,
            "voltage": voltage,
        }
        self._loop.records[:] = self.plant.record.fill(record | {"ground_force": GRAVITY})
        before = np.arange(-len(self._loop.records), 0) * DT  # it has stood there for a while
        self._records["force_integral"][:, 2] = GRAVITY * before
        self._records["force_integral"][0] = 0.0

    def _follow(self, setpoint: ControlSetpoint, armed: bool) -> None:
        """Hand a new setpoint to the inner loop, unless it is one that position control flies."""
        if armed and not self._last[1]:
            self._position_control.home = self.estimate.position_world
        self._last = setpoint, armed
        if setpoint.kind in POSITION_KINDS:
            self._armed[:] = armed
            return
        self._position_control.leave()
        attitude, rate = setpoint.attitude.tolist(), setpoint.rate_body.tolist()
        length = math.hypot(*attitude)
        holds = setpoint.kind == "attitude" and math.isfinite(length) and length > 0
        if holds:
            free, rate, yaw_rate = NOTHING, NOTHING, rate[2] if math.isfinite(rate[2]) else 0.0
        else:  # without a valid attitude PX4 controls no axis
            free = [float(setpoint.kind == "attitude" or not math.isfinite(value)) for value in rate]
            rate, yaw_rate = [0.0 if off else value for off, value in zip(free, rate, strict=True)], 0.0
        thrust = setpoint.thrust if setpoint.kind != "idle" and math.isfinite(setpoint.thrust) else 0.0
        direction = [value / length for value in attitude] if holds else LEVEL
        self._command(armed, direction, thrust, holds=holds, rate=rate, axis_free=free, yaw_rate=yaw_rate)

    def _command(
        self,
        armed: bool,
        attitude: Sequence[float],
        thrust: float,
        *,
        holds: bool = True,
        rate: Sequence[float] = NOTHING,
        axis_free: Sequence[float] = NOTHING,
        yaw_rate: float,
    ) -> None:
        """Write the inner loop's command. holds: whether the attitude is controlled, instead of the rates."""
        parts: dict[str, float | Sequence[float]] = {
            "armed": armed,
            "holds_attitude": holds,
            "attitude": attitude,
            "rate": rate,
            "axis_free": axis_free,
            "yaw_rate": yaw_rate,
            "thrust": thrust,
            "landed": self.land_detector.maybe_landed,
        }
        for name, value in parts.items():
            self._command_parts[name][:] = value
        self._thrust = thrust

    def _supervise(self, setpoint: ControlSetpoint, armed: bool) -> None:
        """Position control and land detection, every few steps."""
        flies_itself = armed and setpoint.kind in POSITION_KINDS
        if not flies_itself and self._step % (2 * SUPERVISION):
            return
        now, detector = self.estimate_now, self.land_detector
        if not self.has_position:  # PX4's land detector then goes without the horizontal speed
            velocity = np.array([0.0, 0.0, now.velocity_world[2]])
            now = dataclasses.replace(now, velocity_world=velocity)
        detector.update(self.time, now, armed=armed, thrust=self._thrust, hover_thrust=self.tuning.hover_thrust)
        self._landed[:] = detector.maybe_landed
        if flies_itself:
            self._position_control.has_position = self.has_position
            demand = self._position_control.fly(setpoint, now, SUPERVISION * DT)
            stays = detector.landed and not demand.climbs
            stays = stays or (detector.ground_contact and setpoint.kind != "hold")
            thrust = 0.0 if stays else demand.thrust
            self._command(armed, demand.attitude, thrust, yaw_rate=demand.yaw_rate)
