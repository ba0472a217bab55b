"""Navigator of the armed vehicle: PX4's navigator and flight mode manager, as far as the mock needs them."""

from __future__ import annotations

import random

import numpy as np

from sitl_mock.autopilot.commander import Commander, Result
from sitl_mock.autopilot.modes import Mode
from sitl_mock.autopilot.parameters import Parameters
from sitl_mock.vehicle.position_control import is_home
from sitl_mock.vehicle.vehicle_interface import ControlSetpoint, Vehicle

IDLE = ControlSetpoint("idle")
SPOOL_UP = (0.02, 0.06)  # s from arming to the first motor command
TAKEOFF_TOLERANCE = 0.3  # m below the take-off height at which the take-off is finished
ON_GROUND, IN_AIR, TAKING_OFF, LANDING = 1, 2, 3, 4  # MAV_LANDED_STATE


class Navigator:
    """Chooses the setpoint that the vehicle follows from the commander's mode.

    setpoint: what is followed now.
    home: (3,) world, m.
    takeoff_altitude: height over the origin, m, of the next take-off; None for MIS_TAKEOFF_ALT over home.
    """

    def __init__(self, vehicle: Vehicle, commander: Commander, parameters: Parameters, source: random.Random):
        """source: random numbers for the time that the rotors take to start."""
        self.setpoint = IDLE
        self.home = vehicle.estimate.position_world
        self.takeoff_altitude: float | None = None
        self._vehicle, self._commander, self._parameters = vehicle, commander, parameters
        self._random = source
        self._setpoint_mode: Mode | None = None  # the mode that the setpoint was chosen in
        self._motors_from = 0.0

    def arm(self, time: float, *, force: bool = False) -> Result:
        """Arm if PX4 would; the place becomes home, and the rotors start a little later."""
        was_armed = self._commander.armed
        result = self._commander.arm(time, force=force)
        if self._commander.armed and not was_armed:
            self.set_home()
            self._motors_from = time + self._random.uniform(*SPOOL_UP)
        return result

    def set_home(self) -> None:
        """The present position becomes home."""
        self.home = self._vehicle.estimate.position_world

    def hold_at(self, setpoint: ControlSetpoint) -> None:
        """Hold somewhere else, in the mode that is flown already."""
        self.setpoint = setpoint
        self._setpoint_mode = self._commander.mode

    def fly(self, duration: float) -> None:
        """Fly what the mode requires for a duration, s, and let the commander react to it."""
        commander, time = self._commander, self._vehicle.time
        powered = commander.armed and not commander.terminated and time >= self._motors_from
        self.setpoint = self._choose_setpoint(time) if commander.armed else IDLE
        self._vehicle.advance(self.setpoint, powered, duration)
        commander.update(self._vehicle.time, landed=self._vehicle.on_ground)
        self._finish_takeoff()

    def landed_state(self) -> int:
        """MAV_LANDED_STATE of the vehicle."""
        if self._commander.landed:
            return ON_GROUND
        if self._commander.mode is Mode.RTL and is_home(self._vehicle.estimate.position_world, self.home):
            return LANDING
        return {Mode.TAKEOFF: TAKING_OFF, Mode.LAND: LANDING}.get(self._commander.mode, IN_AIR)

    def _choose_setpoint(self, time: float) -> ControlSetpoint:
        mode = self._commander.mode
        if mode is Mode.OFFBOARD:
            self._setpoint_mode = mode
            return self._commander.offboard.setpoint(time) or IDLE
        if self._commander.landed and mode is not Mode.TAKEOFF:
            self._setpoint_mode = None  # chosen again once in the air
            return self.setpoint if self.setpoint.kind == "land" else IDLE
        if mode is self._setpoint_mode:
            return self.setpoint
        self._setpoint_mode = mode
        return self._position_setpoint(mode)

    def _position_setpoint(self, mode: Mode) -> ControlSetpoint:
        if mode in (Mode.LAND, Mode.RTL):
            return ControlSetpoint("land" if mode is Mode.LAND else "rtl")
        here = np.array(self._vehicle.estimate.position_world)
        if mode is Mode.TAKEOFF:
            above_home = self.home[2] + self._parameters["MIS_TAKEOFF_ALT"]
            here[2] = self.takeoff_altitude if self.takeoff_altitude is not None else above_home
        return ControlSetpoint("hold", position_world=here)

    def _finish_takeoff(self) -> None:
        is_taking_off = self._commander.mode is Mode.TAKEOFF and self._setpoint_mode is Mode.TAKEOFF
        if is_taking_off and self.setpoint.kind == "hold":
            height = float(self._vehicle.estimate.position_world[2])
            if abs(height - float(self.setpoint.position_world[2])) < TAKEOFF_TOLERANCE:
                self._commander.finish_takeoff()
                self.hold_at(self.setpoint)
