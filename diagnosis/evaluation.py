"""How far a model is from flights, channel by channel, against the sensors' noise floor."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from diagnosis import channels
from diagnosis.filters import Floats
from diagnosis.noise import NoiseModel
from diagnosis.prediction import Prediction, Predictor
from diagnosis.stretch import Stretch
from dynamics.effect import Effect
from dynamics.vehicle import Vehicle


@dataclass(frozen=True)
class Biases:
    """What the sensors are off by within their specification: gyro rad/s, accelerometer m/s^2, clock s."""

    gyro: tuple[float, float, float] = (0.0, 0.0, 0.0)
    accelerometer: tuple[float, float, float] = (0.0, 0.0, 0.0)
    clock: float = 0.0


def residuals(
    vehicle: Vehicle, catalogue: Mapping[str, Effect], stretches: Sequence[Stretch], biases: Biases | None = None
) -> list[Floats]:
    """(m, 12) of each stretch: what was measured less what the vehicle's model says with the sensors' biases."""
    off = biases or Biases()
    predictor = Predictor(vehicle, vehicle.effects, catalogue, speed_measured=stretches[0].rotor_source == "measured")
    found = []
    for stretch in stretches:
        said = predictor.predict(stretch)
        with_biases = Prediction(
            said.specific_force + off.accelerometer,
            said.angular_acceleration,
            said.rate - off.gyro,
            said.pose_age + off.clock,
            true_force=said.true_force,
        )
        found.append(channels.residual(stretch, with_biases))
    return found


def misfit(rows: Sequence[Floats], noise: NoiseModel) -> float:
    """Mean squared whitened residual: 1 for a model that explains everything but the sensors' noise."""
    white = [noise.whiten(r) for r in rows]
    return float(sum(np.sum(w**2) for w in white) / sum(w.size for w in white))


def floors(noise: NoiseModel) -> dict[str, float]:
    """Noise floor of each kind: norm over its three axes, 0 where the kind is absent."""
    return {kind: float(np.sqrt(np.sum(noise.floor[3 * i : 3 * i + 3] ** 2))) for i, kind in enumerate(channels.KINDS)}
