"""Replay: a recorded flight through the flight logic, tick by tick, its setpoints compared with the recorded ones."""

from __future__ import annotations

import msgspec
import numpy as np

from dynamics.decoding import decode_json
from dynamics.errors import DataError
from dynamics.vehicle import Vehicle
from runtime.autopilot_parameters import recorded_rate_gains
from runtime.control.bundle import Bundle
from runtime.control.controller import ControllerOptions
from runtime.flight.composition import build_controllers, build_flyer, use_lookaheads
from runtime.flight.decision import Decision, FlyerSettings
from runtime.flight.flyer import Flyer
from runtime.flight.last_setpoint import LOSS_TIME, USUAL_LOSS_TIME
from runtime.flight.mission import Plan
from runtime.flight.motion import Motion
from runtime.flight.thrust import THRUST_CURVE
from runtime.link.estimate import StateEstimate
from runtime.record.recording import FlightRecording
from runtime.record.records import EstimateRecord, ObservationRecord, ParameterRecord, SetpointRecord, StateRecord

REQUIRED = ("plan", "settings", "controller")


class ReplayReport(msgspec.Struct, frozen=True):
    """The comparison of a replay with its recording.

    ticks: replayed.
    lost: ticks that the recorder dropped.
    compared: setpoints on both sides.
    identical: of those, equal bit for bit.
    unmatched: setpoints on one side only.
    rate_difference: greatest, rad/s.
    thrust_difference: greatest, of 0..1.
    first_difference: s since the first tick, None without one.
    states_agree: whether the same transitions happened.
    """

    ticks: int
    lost: int
    compared: int
    identical: int
    unmatched: int
    rate_difference: float
    thrust_difference: float
    first_difference: float | None
    states_agree: bool

    @property
    def exact(self) -> bool:
        """Whether all setpoints and transitions are as recorded, bit for bit."""
        return self.compared == self.identical and not self.unmatched and self.states_agree

    @property
    def lines(self) -> list[str]:
        """The comparison in words."""
        lost = f", {self.lost} were not recorded" if self.lost else ""
        lines = [f"{self.ticks} ticks{lost}, {self.compared} setpoints compared"]
        if self.exact:
            return [*lines, "bit for bit as recorded"]
        lines.append(f"{self.identical} identical, {self.unmatched} on one side only")
        lines.append(f"rates differ by at most {self.rate_difference:.3g} rad/s")
        lines.append(f"thrust differs by at most {self.thrust_difference:.3g}")
        if self.first_difference is not None:
            lines.append(f"first difference after {self.first_difference:.3f} s")
        return [*lines, f"states {'as recorded' if self.states_agree else 'differ'}"]


def replay(
    recording: FlightRecording, vehicle: Vehicle, reference: Motion, bundle: Bundle | None = None
) -> ReplayReport:
    """Replay a recording's estimates and observations.

    bundle: of the learned model to fly, instead of the vehicle's own.
    Raises DataError when the recording lacks what that requires.
    """
    if recording.first_part > 1:
        raise DataError(
            f"{recording.path} is the rest of a longer flight: its parts before part {recording.first_part} are not "
            "there, as --record-limit removes them. A replay begins at the first tick. `alula inspect` and `alula "
            "diagnose` read each part; for a replay fly with a larger limit, or without one."
        )
    flyer = _flyer(recording, vehicle, reference, bundle)
    estimates = {record.arrival: _estimate(record) for record in recording.records(EstimateRecord)}
    observations: list[ObservationRecord] = recording.records(ObservationRecord)
    if not observations:
        raise DataError(f"{recording.path} holds no ticks of a flight: was it recorded with `alula fly --record`?")
    decisions: list[tuple[float, Decision]] = []
    for observation in observations:
        if not np.isnan(observation.estimate_arrival) and observation.estimate_arrival not in estimates:
            continue  # the recorder dropped the estimate: the tick cannot be compared
        decisions.append((observation.time, flyer.step(observation, estimates.get(observation.estimate_arrival))))
        flyer.prepare(observation.time)
    ticks = [observation.tick for observation in observations]
    lost = ticks[-1] - ticks[0] + 1 - len(decisions)
    return _compare(recording, decisions, lost)


def _flyer(recording: FlightRecording, vehicle: Vehicle, reference: Motion, bundle: Bundle | None) -> Flyer:
    metadata = recording.metadata
    missing = [name for name in REQUIRED if name not in metadata]
    if missing:
        raise DataError(f"{recording.path} lacks the settings {', '.join(missing)}: it was not written by `alula fly`.")
    plan = decode_json(metadata["plan"], Plan)
    settings = decode_json(metadata["settings"], FlyerSettings)
    options = decode_json(metadata["controller"], ControllerOptions)
    parameters = {record.name: record.value for record in recording.records(ParameterRecord)}
    controllers = build_controllers(vehicle, bundle, options)
    if (gains := recorded_rate_gains(recording.records(ParameterRecord))) is not None:
        use_lookaheads(controllers, options.for_autopilot(vehicle, gains))
    return build_flyer(
        controllers,
        reference,
        plan,
        settings,
        thrust_curve=parameters.get(THRUST_CURVE, 0.0),
        loss_time=parameters.get(LOSS_TIME, USUAL_LOSS_TIME),
    )


def _estimate(record: EstimateRecord) -> StateEstimate:
    parts = (record.position_world, record.velocity_world, record.attitude, record.rate_body)
    return StateEstimate(record.time, record.arrival, np.concatenate(parts), record.reset_counter, True, "ODOMETRY")


def _compare(recording: FlightRecording, decisions: list[tuple[float, Decision]], lost: int) -> ReplayReport:
    recorded = {record.time: record for record in recording.records(SetpointRecord)}
    rate_difference = thrust_difference = 0.0
    compared = identical = unmatched = 0
    first: float | None = None
    for time, decision in decisions:
        before = recorded.get(time)
        if before is None or decision.rate_body is None:
            unmatched += before is not None or decision.rate_body is not None
            continue
        compared += 1
        rate = float(np.max(np.abs(decision.rate_body - before.rate_body)))
        thrust = abs(decision.thrust - before.thrust)
        rate_difference, thrust_difference = max(rate_difference, rate), max(thrust_difference, thrust)
        if rate == 0.0 and thrust == 0.0:
            identical += 1
        elif first is None:
            first = time - decisions[0][0]
    steps = [step for _, decision in decisions for step in decision.transitions]
    flown = [(step.time, step.before.value, step.after.value) for step in steps]
    return ReplayReport(
        ticks=len(decisions),
        lost=lost,
        compared=compared,
        identical=identical,
        unmatched=unmatched,
        rate_difference=rate_difference,
        thrust_difference=thrust_difference,
        first_difference=first,
        states_agree=_transitions(recording) == flown,
    )


def _transitions(recording: FlightRecording) -> list[tuple[float, str, str]]:
    """Time, before and after of each recorded transition; the reason is prose and not compared."""
    return [(row.time, row.before, row.after) for row in recording.records(StateRecord)]
