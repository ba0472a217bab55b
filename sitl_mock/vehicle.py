"""The flying vehicle: plant, inner loop, sensors, battery and the modes that fly by themselves.

Simulated time goes in steps of 1 ms, and every step has its own random numbers: what happens depends on the seed and
on when setpoints arrive, not on how the time is cut into calls. Pure: no clock, no link.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynamics import quaternion
from dynamics.vehicle import EffectUse
from dynamics.vehicle import Vehicle as VehicleFile
from sitl_mock import ground
from sitl_mock.allocation import mixer
from sitl_mock.battery import Battery, open_circuit_voltage, usual_battery
from sitl_mock.land_detector import LandDetector
from sitl_mock.plant import DT, Plant, build_plant
from sitl_mock.position_control import PositionControl
from sitl_mock.sensors import SensorErrors, quantised
from sitl_mock.step_loop import StepLoop
from sitl_mock.tuning import default_tuning
from sitl_mock.vehicle_interface import BatteryState, ControlSetpoint, ImuSample, MotionState, Tuning

Vector = NDArray[np.float64]

NOISE_BLOCK = 512  # steps whose random numbers are drawn at once
SUPERVISION = 10  # steps between two looks of position control and land detector
POSITION_KINDS = ("hold", "land", "rtl")


@dataclass(frozen=True)
class VehicleOptions:
    """What surrounds the vehicle and how well it measures.

    ground_height, position (east, north), yaw: where it stands at the start, m and rad. rotor_noise: standard
    deviation of a rotor's speed over its speed, white. battery: None for one that suits the vehicle.
    rotor_speed_fault: what the measured speed of single rotors is multiplied by (0: a dead sensor).
    """

    sensors: SensorErrors = dataclasses.field(default_factory=SensorErrors)
    ground_height: float = 0.0
    position: tuple[float, float] = (0.0, 0.0)
    yaw: float = 0.0
    rotor_noise: float = 0.002
    battery: Battery | None = None
    rotor_speed_fault: tuple[tuple[int, float], ...] = ()


class SimulatedVehicle:
    """A vehicle on the ground, disarmed, at simulated time 0.

    effects: what the vehicle file does not know about the vehicle. tuning: None for that of a careful owner.
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
    ) -> None:
        self.vehicle = vehicle
        self.options = options or VehicleOptions()
        self.plant: Plant = build_plant(vehicle, effects)
        self._random = np.random.default_rng(seed)
        self._loop = StepLoop(self.plant)
        self._records = self.plant.record.views(self._loop.records)
        self._command = self.plant.command.views(self._loop.command)
        self._constants = self.plant.constants.views(self._loop.constants)
        self._noise = np.empty((NOISE_BLOCK, self.plant.noise.size))
        self._battery = self.options.battery or usual_battery(vehicle)
        self._step = 0
        self._due = 0.0
        self._last: tuple[ControlSetpoint | None, bool] = (None, False)
        self._thrust = 0.0
        self.land_detector = LandDetector()
        self._set_constants()
        self._set_state()
        self.tuning = tuning or default_tuning(vehicle)
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
            self._take(setpoint, armed)
        while self._step < end:
            if self._step % SUPERVISION == 0:
                self._supervise(setpoint, armed)
            if self._step % NOISE_BLOCK == 0:
                self._random.standard_normal(out=self._noise)
            steps = min(end, *(self._step // n * n + n for n in (SUPERVISION, NOISE_BLOCK))) - self._step
            self._loop.run(steps, self._step + 1, self._noise, self._step % NOISE_BLOCK)
            self._step += steps

    # what it knows of itself

    @property
    def time(self) -> float:
        """Simulated time, s."""
        return self._step * DT

    @property
    def truth(self) -> MotionState:
        """The plant's state."""
        row = self._records["truth"][self._row(0)]
        return MotionState(self.time, row[0:3].copy(), row[3:6].copy(), row[6:10].copy(), row[10:13].copy())

    @property
    def estimate(self) -> MotionState:
        """What the estimator says: as old as its delay, with its errors, rates from the filtered gyro."""
        return self._estimate(min(round(self.options.sensors.delay / DT), self._step))

    @property
    def imu(self) -> ImuSample:
        """The newest inertial measurement, averaged over the last few samples, at the centre of mass."""
        count = max(1, min(round(self.options.sensors.imu_average / DT), self._step + 1))
        rows = [self._row(age) for age in range(count)]
        force, rate = self._records["specific_force"][rows], self._records["gyro"][rows]
        return ImuSample(self.time, force.mean(axis=0), rate.mean(axis=0))

    @property
    def rotor_speed(self) -> Vector:
        """(rotors,) measured, rad/s, in the vehicle file's order."""
        measured = self._records["rotor_speed_measured"][self._row(0)].copy()
        for rotor, factor in self.options.rotor_speed_fault:
            measured[rotor] *= factor
        return np.maximum(quantised(measured, self.options.sensors.rotor_speed_step), 0.0)

    @property
    def true_rotor_speed(self) -> Vector:
        """(rotors,) rad/s, as they turn."""
        return self._records["rotor_speed"][self._row(0)].copy()

    @property
    def motor_signal(self) -> Vector:
        """(rotors,) 0..1, in the vehicle file's order."""
        return self._records["motor_signal"][self._row(0)].copy()

    @property
    def rotor_position(self) -> Vector:
        """(rotors, 3) m, body FLU."""
        return np.array(self.vehicle.rotors.position)

    @property
    def battery(self) -> BatteryState:
        """The battery now."""
        row = self._row(0)
        voltage, current, charge = (float(self._records[name][row, 0]) for name in ("voltage", "current", "charge"))
        return BatteryState(voltage, current, charge)

    @property
    def on_ground(self) -> bool:
        """Whether the land detector believes that the vehicle has landed."""
        return self.land_detector.landed

    @property
    def ground_force(self) -> float:
        """Share of the weight that the ground carries now."""
        return float(self._records["ground_force"][self._row(0), 0]) / ground.GRAVITY

    # inside

    def _row(self, age: int) -> int:
        return (self._step - age) % self._loop.records.shape[0]

    def _estimate(self, age: int) -> MotionState:
        row = self._row(age)
        truth, error = self._records["truth"][row], self._records["estimate_error"][row]
        attitude = quaternion.multiply(truth[6:10], quaternion.exponential(error[6:9]))
        return MotionState(
            (self._step - age) * DT,
            truth[0:3] + error[0:3],
            truth[3:6] + error[3:6],
            attitude,
            self._records["rate"][row].copy(),
        )

    def _set_constants(self) -> None:
        vehicle, model = self.vehicle, self.plant.model
        rotors, battery = vehicle.rotors, self._battery
        mix = mixer(rotors)
        constants = {
            "model": model.parameter_values,
            "mixer": mix,
            "unmixer": np.linalg.pinv(mix),
            "feet": ground.contact_points(vehicle) - self._centre_of_mass()[:, None],
            "mass_over_inertia": vehicle.body.mass / np.array(vehicle.body.inertia),
            "ground_height": self.options.ground_height,
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
        }
        self._loop.constants[:] = self.plant.constants.fill(constants)

    def _centre_of_mass(self) -> Vector:
        """Where it really lies, body FLU, m."""
        moved = [item.values for item in self.plant.model.effects if item.effect.name == "centre_of_mass"]
        offset = np.array(self.vehicle.body.centre_of_mass)
        return offset + sum((np.array([values[axis] for axis in "xyz"]) for values in moved), np.zeros(3))

    def _set_state(self) -> None:
        model = self.plant.model
        east, north = self.options.position
        height = self.options.ground_height + ground.leg_height(self.vehicle) - ground.SINKAGE
        attitude = quaternion.from_euler(0.0, 0.0, self.options.yaw)
        centre = self._centre_of_mass()
        position = np.array([east, north, height]) + quaternion.rotate(attitude, centre)
        x = model.initial_state(np.concatenate([position, np.zeros(3), attitude, np.zeros(3)]))
        for item in model.effects:
            if item.effect.rotor_speed is not None:
                x[item.hidden["rotor_speed"]] = 0.0
        voltage = self._battery.cells * float(open_circuit_voltage(self._battery.charge))
        state = {"plant": x, "charge": self._battery.charge, "voltage": voltage}
        self._loop.state[:] = self.plant.state.fill(state)
        record = {"truth": x[0:13], "charge": self._battery.charge, "voltage": voltage, "ground_force": ground.GRAVITY,
                  "specific_force": [0, 0, ground.GRAVITY]}  # fmt: skip
        self._loop.records[0] = self.plant.record.fill(record)

    def _take(self, setpoint: ControlSetpoint, armed: bool) -> None:
        """Hand a new setpoint to the inner loop, unless it is one that position control flies."""
        self._last = setpoint, armed
        self._command["armed"][:] = armed
        if setpoint.kind in POSITION_KINDS:
            return
        self._position_control.leave()
        rates = setpoint.kind in ("rates", "idle")
        attitude = setpoint.attitude / np.linalg.norm(setpoint.attitude)
        lost = not np.isfinite(attitude).all()  # PX4 then controls no axis at all
        free = np.full(3, True) if lost and not rates else ~np.isfinite(setpoint.rate_body) & rates
        thrust = 0.0 if setpoint.kind == "idle" else float(np.nan_to_num(setpoint.thrust))
        self._command["holds_attitude"][:] = not rates and not lost
        self._command["attitude"][:] = [1.0, 0.0, 0.0, 0.0] if lost else attitude
        self._command["rate"][:] = np.nan_to_num(setpoint.rate_body) if rates else 0.0
        self._command["axis_free"][:] = free
        self._command["yaw_rate"][:] = 0.0 if rates else np.nan_to_num(setpoint.rate_body[2])
        self._command["thrust"][:] = self._thrust = thrust

    def _supervise(self, setpoint: ControlSetpoint, armed: bool) -> None:
        """Position control and land detection, every few steps."""
        now = self._estimate(0)
        detector = self.land_detector
        detector.update(self.time, now, armed=armed, thrust=self._thrust, hover_thrust=self.tuning.hover_thrust)
        self._command["landed"][:] = detector.maybe_landed or detector.landed
        if setpoint.kind not in POSITION_KINDS or not armed:
            return
        demand = self._position_control.fly(setpoint, now, SUPERVISION * DT)
        grounded = detector.ground_contact and setpoint.kind != "hold"
        self._thrust = 0.0 if grounded else demand.thrust
        self._command["holds_attitude"][:] = 1.0
        self._command["attitude"][:] = demand.attitude
        self._command["axis_free"][:] = 0.0
        self._command["yaw_rate"][:] = demand.yaw_rate
        self._command["thrust"][:] = self._thrust
