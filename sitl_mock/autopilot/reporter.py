"""Reports of the vehicle about itself: snapshots for the streams and for messages that are requested once."""

from __future__ import annotations

from sitl_mock.autopilot.commander import Commander
from sitl_mock.autopilot.navigator import Navigator
from sitl_mock.vehicle.clock import VehicleClock
from sitl_mock.vehicle.vehicle_interface import Vehicle
from sitl_mock.wire.estimate_fault import EstimateFault
from sitl_mock.wire.motion_messages import BODY_FRD, LOCAL_NED
from sitl_mock.wire.snapshot import MotionEncoder, Snapshot, VehicleStatus, motor_order, ned

TYPE_OF_ROTORS = {4: 2, 6: 13, 8: 14}  # MAV_TYPE by number of rotors


class Reporter:
    """Takes snapshots of a vehicle and its autopilot."""

    def __init__(
        self,
        vehicle: Vehicle,
        commander: Commander,
        navigator: Navigator,
        clock: VehicleClock,
        estimate_fault: EstimateFault,
        *,
        epoch: float,
        body_velocity: bool,
    ):
        """epoch: unix time at boot, s. body_velocity: ODOMETRY's velocity in BODY_FRD instead of LOCAL_NED."""
        self._vehicle, self._commander, self._navigator = vehicle, commander, navigator
        self._clock, self._estimate_fault = clock, estimate_fault
        self._epoch = epoch
        self._child_frame = BODY_FRD if body_velocity else LOCAL_NED
        self._encoder = MotionEncoder()
        self._order = motor_order(vehicle.rotor_position)

    def snapshot(self, time: float) -> Snapshot:
        """The content of all streams at a simulated time, s."""
        commander, navigator = self._commander, self._navigator
        status = VehicleStatus(
            base_mode=commander.base_mode(),
            custom_mode=commander.mode.custom_mode,
            system_status=int(commander.system_status(time)),
            landed_state=navigator.landed_state(),
            armable=commander.armed or commander.may_arm(time),
            vehicle_type=TYPE_OF_ROTORS.get(len(self._order), 2),
            child_frame=self._child_frame,
            epoch=self._epoch,
            home=ned(navigator.home),
            setpoint=navigator.setpoint,
        )
        return Snapshot(time, self._vehicle, self._clock, self._estimate_fault, self._encoder, self._order, status)
