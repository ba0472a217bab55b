"""A component of a user's own is one file, and is refused with its line where it contradicts itself."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from diagnosis.noise.component import hover
from diagnosis.noise.components import CATALOGUE
from diagnosis.noise.composition import Composition
from diagnosis.noise.discretisation import discretise
from diagnosis.noise.own_components import catalogue_with
from dynamics.approvals import approve
from dynamics.effect_source import EffectFile, read_effect_file
from dynamics.errors import RequestError
from dynamics.vehicle_file import read_vehicle
from tests.diagnosis.noise import gaussian
from tests.diagnosis.noise.kalman_filter import filter_rows
from vehicles import FOLDER

HOVER = hover(read_vehicle(FOLDER / "crazyflie.toml"), 0.01, 100.0, 500.0)

VIBRATION = '''"""Vibration of an arm: a damped line in the vertical specific force."""

import numpy as np

from diagnosis.noise.component import Component, Hyperparameter, fixed_prior
from diagnosis.noise.linear_model import chain


def model(p, _):
    """d2x/dt2 = -omega^2 x - 2 damping omega dx/dt + w."""
    omega, damping = 2 * np.pi * p["frequency"], p["damping"]
    F = np.array([[0.0, 1.0], [-(omega**2), -2 * damping * omega]])
    return chain("accelerometer_z", F, np.array([1.0, 0.0]), p["std"] * np.sqrt(4 * damping * omega**3))


def spectrum(p, _, frequency):
    """4 std^2 damping omega_0^3 / ((omega_0^2 - omega^2)^2 + (2 damping omega_0 omega)^2)."""
    own, omega, damping = 2 * np.pi * p["frequency"], 2 * np.pi * frequency, p["damping"]
    shape = (own**2 - omega**2) ** 2 + (2 * damping * own * omega) ** 2
    return {"accelerometer_z": 4 * p["std"] ** 2 * damping * own**3 / shape}


COMPONENT = Component(
    name="arm_vibration",
    summary="Vibration of an arm",
    source="damped oscillator",
    parameters=(
        Hyperparameter("std", "m/s^2", "of the vibration", 1e-3, 10.0, fixed_prior(0.3, 1.0)),
        Hyperparameter("frequency", "Hz", "of the arm", 5.0, 100.0, fixed_prior(17.0, 0.5)),
        Hyperparameter("damping", "1", "over the critical one", 1e-3, 0.9, fixed_prior(0.1, 1.0)),
    ),
    model=model,
    spectrum=spectrum,
)
'''


def own_file(folder: Path, text: str) -> EffectFile:
    path = folder / "my_noise.py"
    path.write_text(text)
    file = read_effect_file(path)
    approve([("effects", file.sha256, str(path))])
    return file


def test_a_file_adds_a_component_that_composes_with_the_catalogues(tmp_path: Path) -> None:
    catalogue = catalogue_with([own_file(tmp_path, VIBRATION)], HOVER)
    assert list(catalogue) == [*CATALOGUE, "arm_vibration"]
    composition = Composition((catalogue["arm_vibration"], catalogue["accelerometer"]))
    values = composition.medians(HOVER.vehicle) | {"accelerometer.walk": 1e-3, "accelerometer.density_z": 0.02}
    model = composition.model(values, HOVER)
    count, omega, damping = 30, 2 * np.pi * 17.0, 0.1
    ringing = omega * np.sqrt(1 - damping**2)
    # the vibration's mean over a row, by Gauss-Legendre points of its analytic autocovariance
    nodes, weights = np.polynomial.legendre.leggauss(20)
    times = (HOVER.period * (np.arange(count)[:, None] + (nodes + 1) / 2)).ravel()
    lag = np.abs(times[:, None] - times)
    points = 0.09 * np.exp(-damping * omega * lag)
    points *= np.cos(ringing * lag) + damping * omega / ringing * np.sin(ringing * lag)
    mean = np.kron(np.eye(count), weights / 2)
    covariance = mean @ points @ mean.T + gaussian.sensor_means(count, HOVER.period, 0.02, 1e-3, 0.02)
    readings = np.full((count, len(model.outputs)), np.nan)
    series = np.linalg.cholesky(covariance) @ np.random.default_rng(2).standard_normal(count)
    readings[:, model.outputs.index("accelerometer_z")] = series
    discrete = discretise(model, HOVER.period, model.outputs)
    computed = filter_rows(discrete, model.start_covariance(), readings).log_likelihood
    assert computed == pytest.approx(gaussian.log_density(series, covariance), rel=1e-7)


@pytest.mark.parametrize(("before", "after", "reason"), [
    ("4 * damping * omega**3", "2 * damping * omega**3", "its spectrum of accelerometer_z at .* Hz is .* gives"),
    ('"accelerometer_z": 4', '"accelerometer_x": 4', r"spectrum is of \['accelerometer_x'\], its model of"),
    ('chain("accelerometer_z"', 'chain("accelerometer_up"', "accelerometer_up are no channels"),
    ('p["frequency"], p["damping"]', 'p["frequenzy"], p["damping"]', "line 11: .*KeyError: 'frequenzy'"),
    ("-2 * damping * omega]", "2 * damping * omega]", "no stationary variance"),
    ('name="arm_vibration"', 'name="gyro"', "there is a component 'gyro' already"),
    ("COMPONENT = ", "VIBRATION = ", "defines no COMPONENT"),
    ("1e-3, 10.0, fixed", "10.0, 1e-3, fixed", "bounds 10.0 and 0.001 are not"),
    ("import numpy as np", "import numpy as", "line 3: SyntaxError"),
])  # fmt: skip
def test_a_contradiction_is_refused_with_its_reason(tmp_path: Path, before: str, after: str, reason: str) -> None:
    assert before in VIBRATION
    with pytest.raises(RequestError, match=reason):
        catalogue_with([own_file(tmp_path, VIBRATION.replace(before, after))], HOVER)


def test_a_file_that_is_not_approved_does_not_run(tmp_path: Path, nothing_approved: Path) -> None:
    path = tmp_path / "my_noise.py"
    path.write_text("raise SystemExit")
    with pytest.raises(RequestError, match="alula trust"):
        catalogue_with([read_effect_file(path)], HOVER)


def test_components_of_a_file_may_need_each_other_but_nothing_that_is_absent(tmp_path: Path) -> None:
    twins = VIBRATION.replace("COMPONENT = Component(", "FIRST = Component(\n    needs=('gyro', 'second'),")
    second = "COMPONENTS = [FIRST, replace(FIRST, name='second', needs=())]\n"
    catalogue = catalogue_with([own_file(tmp_path, f"from dataclasses import replace\n{twins}{second}")], HOVER)
    assert {"arm_vibration", "second"} < set(catalogue)
    with pytest.raises(RequestError, match="it needs second; there are turbulence, "):
        catalogue_with([own_file(tmp_path, twins.replace("FIRST =", "COMPONENT ="))], HOVER)
