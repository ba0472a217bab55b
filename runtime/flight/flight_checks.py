"""The checks of a flight: the events that observations, estimates, setpoints and the external force show. Pure."""

from __future__ import annotations

from dynamics.arrays import Floats
from dynamics.decoding import decode_json
from dynamics.vehicle import Vehicle
from runtime.flight.attribution import Attribution
from runtime.flight.controller_pair import ControllerPair
from runtime.flight.decision import FlyerSettings
from runtime.flight.engagement import Engagement
from runtime.flight.events import Event
from runtime.flight.ground_contact import GroundContact
from runtime.flight.health import FlightHealth
from runtime.flight.measurements import Measurements
from runtime.flight.mission import Mission
from runtime.flight.rotor_findings import rotor_findings
from runtime.flight.setpoint_output import SetpointOutput
from runtime.flight.start_pose import StartPose
from runtime.link.estimate import StateEstimate
from runtime.record.records import ObservationRecord

FAILSAFE_TIME = 0.3  # s without a setpoint, after which an autopilot's failsafe may act (COM_OF_LOSS_T is not less)


class FlightChecks:
    """Reads the parts of a flight, and collects the events that they show.

    pending: events for the next tick, with details.
    health: of estimates and setpoints.
    attribution: of events to their causes.
    ground: contact with it, by the external force.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        settings: FlyerSettings,
        engagement: Engagement,
        mission: Mission,
        controllers: ControllerPair,
        output: SetpointOutput,
        measured: Measurements,
    ) -> None:
        self.pending: dict[Event, str] = {}
        self.health = FlightHealth(vehicle, settings.health)
        self.attribution = Attribution(settings.period)
        self.ground = GroundContact(vehicle, settings.period)
        self._mass = vehicle.body.mass
        self._engagement, self._mission, self._measured = engagement, mission, measured
        self._controllers, self._output = controllers, output

    def present(
        self, observation: ObservationRecord, pose: StartPose, motors: tuple[int, ...] | None
    ) -> dict[Event, str]:
        """Events that are present at a tick. pose: before take-off. motors: of the rotors, None where not known."""
        present, self.pending = self.pending, {}
        if observation.findings:
            present |= {Event(name): text for name, text in decode_json(observation.findings).items()}
        present |= self.health.estimate_age(self._measured.estimate, observation.time)
        present |= self._measured.frozen() | self._measured.heading.findings()
        for adaptation in self._controllers.adaptations:
            present |= rotor_findings(adaptation, motors)
        left_in_flight = self._mission.airborne and observation.armed
        if not (self._engagement.flying or self._engagement.initially_armed or left_in_flight):
            present |= pose.findings()
        if not self._engagement.flying:
            return present
        if not self._mission.policy.may_disarm:
            present |= self._control_lost(observation)
        return self.attribution.attribute(present)

    def _control_lost(self, observation: ObservationRecord) -> dict[Event, str]:
        if not observation.armed:
            return {Event.DISARMED: f"in phase {self._mission.phase.value}"}
        if observation.offboard:
            return {}
        standstill = self.standstill
        after = f", after this computer stood still for {standstill:.1f} s" if standstill else ""
        return {Event.MODE_CHANGED: f"to {observation.mode}{after}"}

    @property
    def standstill(self) -> float:
        """For how long this computer stood still lately, s; 0 for less than an autopilot's failsafe waits."""
        standstill = self.attribution.standstill
        return standstill if standstill > FAILSAFE_TIME else 0.0

    # --- after the setpoint has left

    def take_sent(self) -> None:
        """Take the setpoint that has left, for the checks and the models that compare with it."""
        if (sent := self._output.departed()) is None:
            return
        rate_body, collective_thrust, thrust, time = sent
        self.health.sent(rate_body, collective_thrust, time)
        effectiveness = self._output.effectiveness.value
        realised = self._output.thrust_map.collective_thrust(thrust, effectiveness)
        self._controllers.sent(realised, time, effectiveness)

    def check_flight(self, estimate: StateEstimate, time: float) -> None:
        """Check the flight by a fresh estimate, and update the effectiveness. time: s."""
        measured, adaptation = self._measured, self._controllers.adaptation
        self.pending |= self.health.flight(estimate.state, time, learned=self._controllers.main.is_learned)
        force, landing = measured.vertical_force, self._mission.policy.lands
        if adaptation is not None:
            force -= adaptation.specific_drag(estimate.state)
        near = landing and self.ground.may_be_near(self._mission, estimate.state, reported_landed=False)
        self.pending |= self._output.measure(estimate, measured.force, force, near_ground=near)
        if adaptation is not None and not landing:
            adaptation.read_voltage(estimate.time, measured.voltage, self._output.effectiveness.value)

    def measure_force(self, time: float, reference: Floats | None) -> None:
        """Update the external force, and the events that it shows. reference: state (13,) at this time, or None."""
        estimate, effectiveness = self._measured.estimate, self._output.effectiveness
        if not self._engagement.flying or estimate is None or not self._mission.policy.leaves_ground:
            self.ground.clear()
            return
        thrust = effectiveness.thrust(time) / self._mass
        missing = thrust * (effectiveness.initial / effectiveness.value - 1)
        if (adaptation := self._controllers.adaptation) is not None:
            # the effectiveness was fitted beside the drag that the model follows: both make the modelled force
            thrust += adaptation.specific_drag(estimate.state)
        self.pending |= self.ground.measure(
            self._mission, estimate, reference, self._measured.force, thrust, time, missing_thrust=missing
        )
