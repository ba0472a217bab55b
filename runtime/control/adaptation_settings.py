"""Settings of a model that follows in flight: noise of its estimates, and when what it estimates is not flown.

What each does is derived in docs/adaptation.md.
"""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from runtime.control.rotor_loss import RotorLossSettings

Positive = Annotated[float, Meta(gt=0)]
NotNegative = Annotated[float, Meta(ge=0)]
Mode = Literal["off", "shadow", "on"]


class AxisNoise(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Noise of one kind of axis. Accelerations: m/s^2 or rad/s^2.

    measurement: standard deviation of an estimate's velocity or rate, m/s or rad/s.
    drift: of the staying part, acceleration per sqrt(s).
    fading: standard deviation of the fading part, acceleration.
    fading_time: s in which it falls to 1/e.
    limit: of the sum of both parts, acceleration.
    """

    measurement: Positive
    drift: Positive
    fading: Positive
    fading_time: Positive
    limit: Positive


class GuardLimits(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """When what was estimated is not flown: where it has forecast worse than the vehicle file's model does.

    forecast: s ahead.
    averaging: s over which squared errors are averaged, and in which what was estimated fades from the flight.
    tolerance: ratio of errors up to which it is trusted.
    linear_resolution: m/s, error of a velocity that does not count.
    angular_resolution: rad/s, of a rate.
    """

    forecast: Positive = 0.2
    averaging: Positive = 1.0
    tolerance: Positive = 1.1
    linear_resolution: Positive = 0.03
    angular_resolution: Positive = 0.1


class NetworkSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """How a network's last layer follows.

    mode: "off", "shadow" (estimated and recorded, not flown) or "on", as far as the model's own mode lets it.
    rank: directions of its inputs in which it may change, those that varied most in training.
    deviation: m/s^2, RMS over the training's inputs of the change that is expected beforehand, by axis.
    memory: s in which a change returns to what was trained by the factor e, and its variance to the one beforehand.
    bound: m/s^2, of that RMS by axis.
    limit: m/s^2, of the change where the vehicle flies now.
    block: s of flight that make one row.
    tolerance: ratio of forecast errors with and without the change, up to which it is trusted.
    """

    mode: Mode = "shadow"
    rank: Annotated[int, Meta(ge=1)] = 8
    deviation: Positive = 0.5
    memory: Positive = 60.0
    bound: Positive = 3.0
    limit: Positive = 4.0
    block: Positive = 0.1
    tolerance: Positive = 1.0


class AdaptationSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """How a model follows in flight.

    mode: "off", "shadow" (estimated and recorded, not flown) or "on".
    follow: effects whose parameters are estimated; those that the model lacks are added to it.
    thrust_lag: s by which thrust follows its commands later than the model predicts.
    moments: whether the angular disturbance is flown, too: with planned rotor speeds it holds what the autopilot's rate
        loop does otherwise, and makes tracking worse.
    linear: noise of velocities, world axes.
    angular: of body rates, body axes.
    gate: standard deviations beyond which an estimate has jumped.
    start: standard deviation of the staying part at the start, as a share of the fading part's.
    walk: of the error of an estimate's velocity, m/s per sqrt(s).
    calm: least level of the noise that drives the linear disturbance, as a share of `linear`. The level follows what
        the last forecasts had as errors: in calm air a disturbance that followed gusts would follow the estimate's.
    rising, falling: s in which the level follows upwards and downwards.
    persistence: s in which a linear disturbance is flown that stays within the noise of its estimate; beyond the noise
        it is at once.
    variation: by how much a drag's slope must vary for it to be followed, m/s^2 per standard deviation of its prior.
    drag_deviations: from zero, beyond which a drag is certain, and shows the wind.
    offset: m/s^2, standard deviation of a constant horizontal force that is none of the wind's, beside a wind that is
        followed; upwards it is free.
    prior_scale: of the priors' standard deviations: a flight in strong wind is none of the usual ones.
    known_drag: standard deviation of a drag that the vehicle file has, as a share of it, if that is less.
    motor_lag: s, of the motors behind the autopilot's outputs.
    rotors: when one that loses thrust is named.
    network: how a network's last layer follows.
    """

    mode: Mode = "off"
    follow: tuple[str, ...] = ()
    thrust_lag: NotNegative = 0.0
    moments: bool = False
    linear: AxisNoise = AxisNoise(measurement=0.02, drift=0.5, fading=1.0, fading_time=1.0, limit=8.0)
    angular: AxisNoise = AxisNoise(measurement=0.05, drift=0.5, fading=2.0, fading_time=0.3, limit=30.0)
    gate: Positive = 6.0
    start: Positive = 1.0
    walk: NotNegative = 0.03
    calm: Positive = 0.3
    rising: Positive = 0.3
    falling: Positive = 1.0
    persistence: Positive = 20.0
    variation: Positive = 0.3
    drag_deviations: Positive = 3.0
    offset: Positive = 0.05
    prior_scale: Positive = 3.0
    known_drag: Positive = 0.06
    motor_lag: NotNegative = 0.0
    rotors: RotorLossSettings = RotorLossSettings()
    guard: GuardLimits = GuardLimits()
    network: NetworkSettings = NetworkSettings()
