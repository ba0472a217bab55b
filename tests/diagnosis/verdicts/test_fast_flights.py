"""Fast flights on a vehicle that its file describes wholly show no inertia: recordings hold mean rotor speeds."""

from diagnosis.data.dataset import make_dataset
from diagnosis.estimation.equation_error import fit
from diagnosis.selection.regression_of_flights import make_regression
from dynamics.effects import CATALOGUE
from fixtures.planted import planted_flights

FAST = ("Lemniscate:plane=xz,laps=3,ramp=1.5,speed=1.3", "Lemniscate:plane=yz,laps=3,ramp=1.5,speed=1.3")
SOME = {name: CATALOGUE[name] for name in ("inertia", "imu_bias", "gyro_bias", "time_delay")}


def test_rotors_that_ripple_with_the_logs_period_do_not_change_the_inertia(arpl_250g):
    dataset = make_dataset(planted_flights(arpl_250g, [], seed=5, manoeuvres=(*FAST, *FAST)), arpl_250g)
    regression = make_regression(arpl_250g, SOME, dataset.fitted, dataset.flight_of)
    inertia = next(c for c in regression.candidates if c.key == "inertia")
    estimates = fit(regression, [inertia]).estimates
    for axis in "xy":
        estimate = estimates["inertia", f"ratio_{axis}"]
        assert abs(estimate.value - 1.0) < 0.003
        assert abs(estimate.value - 1.0) < 3 * estimate.std
