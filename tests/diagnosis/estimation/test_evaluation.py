"""Residuals are free of the errors that healthy sensors have, of a user's own sensors as well."""

from dataclasses import replace
from types import SimpleNamespace

from diagnosis.by_likelihood import noise_of
from diagnosis.estimation.evaluation import reduced_chi_square, residuals, residuals_in
from dynamics.effect import Effect, Parameter, Prior, Reading
from dynamics.effects import CATALOGUE
from tests.diagnosis.synthetic import hovering


def _scaled(reading: Reading, p, _):
    return replace(reading, specific_force=reading.specific_force * (1 + p["scale"]))


SCALE = Effect(
    name="accelerometer_scale",
    summary="The accelerometer's scale is off",
    source="made up",
    parameters=(Parameter("scale", "1", "relative error", -0.5, 0.5, lambda _: Prior(0.0, 0.02)),),
    measurement=_scaled,
    sensor_prior=0.02,
)


def test_errors_within_specification_of_a_users_own_sensor_are_removed_from_residuals(arpl_250g):
    catalogue = {**{name: CATALOGUE[name] for name in ("mass", "imu_bias")}, SCALE.name: SCALE}
    healthy = hovering(arpl_250g, mass_ratio=1.0, seed=4, count=4)
    held_out = [replace(s, specific_force=1.03 * s.specific_force) for s in hovering(arpl_250g, mass_ratio=1.0, seed=5)]
    dataset = SimpleNamespace(fitted=healthy, flight_of=(0, 1, 2, 3))
    noise = noise_of(dataset, arpl_250g, catalogue)
    plain = residuals(arpl_250g, catalogue, held_out)
    assert reduced_chi_square(plain, noise.floor) > 3
    rows = residuals_in(noise, arpl_250g, held_out)
    assert reduced_chi_square(rows, noise.floor) < 1.3
