"""The request for one flight, and the report of it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import msgspec

from dynamics.controller_settings import CONTROL_RATE
from dynamics.signing_key import SigningKey
from dynamics.vehicle import Vehicle
from runtime.control.adaptation import Followed
from runtime.control.adaptation_settings import AdaptationSettings
from runtime.control.bundle import Bundle
from runtime.control.controller import ControllerOptions
from runtime.flight.decision import FlyerSettings
from runtime.flight.mission import Plan
from runtime.flight.tracking import TrackingReport
from runtime.link.connection import Endpoint
from runtime.timing import TimingReport


class FlightRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The daemon's settings for one flight, besides vehicle and reference.

    endpoint: of the link.
    plan: take-off, transfers and landing.
    settings: of the flight logic.
    adaptation: how the model follows in flight.
    rate: control rate, Hz.
    record: folder for the recording, None for none.
    record_limit: bytes of the recording, of which the oldest part goes; None for all of the flight.
    name: of the recording; the date and time if empty.
    system: the vehicle's system id, None for the first one heard.
    roaming: whether the vehicle may continue from another address after a silence.
    signing_key: under which the link is signed, None for an unsigned one.
    timeout: s to wait for the vehicle.
    priority: of SCHED_FIFO, None for none.
    processor: that the control thread stays on, None for any.
    metadata: for the recording: command, versions, seeds, hashes.
    attachments: for the recording: texts by name, such as the vehicle file.
    """

    endpoint: Endpoint
    rate: float = CONTROL_RATE
    plan: Plan = Plan()
    settings: FlyerSettings = FlyerSettings()
    adaptation: AdaptationSettings = AdaptationSettings()
    record: Path | None = None
    record_limit: int | None = None
    name: str = ""
    system: int | None = None
    roaming: bool = False
    signing_key: SigningKey | None = None
    timeout: float = 10.0
    priority: int | None = None
    processor: int | None = None
    metadata: Mapping[str, str] = {}
    attachments: Mapping[str, str] = {}

    @property
    def flyer_settings(self) -> FlyerSettings:
        """The settings of the flight logic at the control rate."""
        return msgspec.structs.replace(self.settings, period=1.0 / self.rate)

    def controller_options(self, vehicle: Vehicle, bundle: Bundle | None) -> ControllerOptions:
        """Options of the vehicle's controller, or of a bundle's."""
        options = ControllerOptions.for_vehicle(vehicle, period=1.0 / self.rate, adaptation=self.adaptation)
        return options if bundle is None else options.for_kernel(bundle.manifest.problem)

    def recording_metadata(self, options: ControllerOptions) -> dict[str, str]:
        """Metadata of the flight's recording. options: the controller's."""
        settings = {
            "plan": msgspec.json.encode(self.plan).decode(),
            "settings": msgspec.json.encode(self.flyer_settings).decode(),
            "controller": msgspec.json.encode(options).decode(),
            "endpoint": str(self.endpoint),
            "rate": repr(self.rate),
        }
        return {**settings, **self.metadata}


class FlightReport(msgspec.Struct, frozen=True):
    """How a flight went.

    outcome: why it ended.
    landed: whether it ended on the ground, disarmed, by the daemon's own landing.
    completed: whether it landed, and not earlier than requested.
    landing_reason: why it was cut short, empty when it was not.
    recording: path, None when nothing was recorded.
    estimate_rate: Hz, at the end.
    events: how often each was raised, by name.
    effectiveness: thrust per modelled thrust, at the end; of a flight that did not end with a landing, as it was before
        the autopilot could have left OFFBOARD without a HEARTBEAT that shows it.
    start_up: s from constructing the daemon to the first setpoint, negative when none was sent.
    scheduling: SCHED_FIFO with its priority or ordinary, and what was refused, each with its remedy.
    origin: of the reference's coordinates in the estimator's, m: where the vehicle stood, or zero.
    followed: what the model followed, None where it did not.
    """

    outcome: str
    landed: bool
    completed: bool
    landing_reason: str
    recording: str | None
    tracking: TrackingReport
    timing: TimingReport
    estimate_rate: float
    events: dict[str, int]
    effectiveness: float
    start_up: float
    scheduling: str
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    followed: Followed | None = None
