"""The gain that is reported is thrust over command, whatever mass the fit has found."""

import pytest

from diagnosis.estimation.command_gain import GAIN_KEY, MASS_KEY, command_gain
from diagnosis.estimation.fitted import Fit, ParameterEstimate
from dynamics.effects.mass import EFFECT as MASS
from dynamics.vehicle import EffectUse
from tests.diagnosis.synthetic import candidate

GAIN = {GAIN_KEY: ParameterEstimate(1.01, 0.0101, "1")}


def test_measured_speeds_have_no_gain(arpl_250g):
    assert command_gain(Fit(arpl_250g, {}, ()), 1.0) is None


def test_without_a_mass_it_is_the_fitted_one(arpl_250g):
    gain = command_gain(Fit(arpl_250g, {}, (), commands=GAIN), 1.0)
    assert (gain.value, gain.std) == pytest.approx((1.01, 0.0101))


@pytest.mark.parametrize(("reference", "value"), [(1.0, 1.25 * 1.01), (1.25, 1.01)])
def test_thrust_grows_with_the_mass_that_it_carries(arpl_250g, reference, value):
    vehicle = arpl_250g.with_effects(EffectUse("mass", {"ratio": 1.25}))
    estimates = {MASS_KEY: ParameterEstimate(1.25, 0.025, "1")}
    gain = command_gain(Fit(vehicle, estimates, (candidate(MASS),), commands=GAIN), reference)
    assert gain.value == pytest.approx(value)
    assert gain.std == pytest.approx(value * 0.0224, rel=0.01)
