"""Sets of seven and eight effects of an outside simulator: what one wrong member of the set hid is named."""

import pytest

import alula
from fixtures.outside_cases import Campaign, flown, write_campaign
from fixtures.outside_sensors import Recorder

BESIDE_A_WRONG_MASS = {
    "rotor_drag": {"coefficient": 8.741e-06}, "rotor_gyroscopic": {"inertia": 4.232e-06},
    "axial_inflow": {"coefficient": 1.882e-05}, "torque_constant": {"ratio": 1.2514},
    "rotor_cant": {"tangential": -0.03546, "radial": -0.02074, "rotor": 1.0},
    "ground_effect": {"gain": 2.373, "radius": 0.07777}, "mass": {"ratio": 1.0513},
}  # fmt: skip
WITH_A_LOOK_ALIKE_OF_INERTIA = {
    "axial_inflow": {"coefficient": 1.2415e-06}, "inertia": {"ratio_x": 1.0501, "ratio_y": 1.1301, "ratio_z": 0.7642},
    "rotational_damping": {"coefficient": 8.885e-05}, "linear_drag": {"coefficient": 0.03174},
    "translational_lift": {"coefficient": 0.00053}, "ground_effect": {"gain": 0.857, "radius": 0.04103},
    "rotor_gyroscopic": {"inertia": 2.2286e-07}, "parasitic_drag": {"coefficient": 0.004103},
}  # fmt: skip
WITH_A_SMALL_THRUST_CONSTANT = {
    "parasitic_drag": {"coefficient": 0.001096}, "rotational_damping": {"coefficient": 3.5276e-05},
    "blade_flapping": {"coefficient": 6.6078e-09}, "weak_rotor": {"loss": 0.02726, "rotor": 2.0},
    "axial_inflow": {"coefficient": 3.1889e-06}, "ground_effect": {"gain": 1.62703, "radius": 0.04223},
    "rotor_cant": {"tangential": -0.014241, "radial": -0.047361, "rotor": 0.0}, "thrust_constant": {"ratio": 0.90848},
}  # fmt: skip

UNDER_TURBULENCE = {
    "axial_inflow": {"coefficient": 3.7105e-05}, "blade_flapping": {"coefficient": 6.1581e-08},
    "torque_constant": {"ratio": 1.07847}, "translational_lift": {"coefficient": 0.00092897},
    "linear_drag": {"coefficient": 0.043432}, "centre_of_mass": {"x": -0.0038609, "y": -0.0020412},
    "rotor_cant": {"tangential": 0.038611, "radial": 0.026115, "rotor": 1.0},
    "ground_effect": {"gain": 0.63297, "radius": 0.078928},
}  # fmt: skip


def answered(campaign: Campaign, folder):
    (truths,) = flown([campaign])
    write_campaign(campaign, truths, folder)
    return alula.diagnose(sorted(map(str, folder.glob("*.csv"))), str(folder / "vehicle.toml"))


def test_what_was_refused_beside_an_open_force_is_judged_again_beside_its_rival(tmp_path):
    """A thrust constant stood for the mass and made the moments worse. Until the mass took its place the weight was
    open, beside which chance refused the torque constant: it was never named."""
    recorder = Recorder(100.0, noise=0.782)
    report = answered(Campaign(BESIDE_A_WRONG_MASS, {}, recorder, False, True, 9, 791206570), tmp_path).report
    named = {effect.name: effect for effect in report.effects}
    assert named["torque_constant"].parameters["ratio"].value == pytest.approx(1.2514, abs=0.01)
    assert named["rotor_cant"].parameters["tangential"].value == pytest.approx(-0.03546, rel=0.05)
    alike = [name for effect in report.effects for name in effect.ambiguous_with]
    assert "thrust_constant" in named["mass"].ambiguous_with
    assert len(alike) <= len(named)  # every rival of a small effect was declared, seven to an effect


def test_the_full_model_decides_between_all_rivals_where_something_is_left(tmp_path):
    """The columns preferred a thrust exponent to an inertia; beside it nothing held, and one of eight was named."""
    recorder = Recorder(400.0, noise=0.531)
    campaign = Campaign(WITH_A_LOOK_ALIKE_OF_INERTIA, {}, recorder, False, False, 9, 388477791)
    report = answered(campaign, tmp_path).report
    named = {effect.name for effect in report.effects}
    assert set(WITH_A_LOOK_ALIKE_OF_INERTIA) - {"ground_effect"} <= named
    assert named <= set(WITH_A_LOOK_ALIKE_OF_INERTIA)
    assert report.verdict in ("effect", "ambiguous")


def test_a_mass_beside_the_inertia_that_undoes_its_moments_is_a_thrust_constant(tmp_path):
    """Both were named with every resample: turbulence let the inertia gain more than its coefficients cost."""
    recorder = Recorder(100.0, noise=0.519)
    campaign = Campaign(WITH_A_SMALL_THRUST_CONSTANT, {}, recorder, False, False, 9, 1661390903)
    report = answered(campaign, tmp_path).report
    named = {effect.name: effect for effect in report.effects}
    assert set(named) == set(WITH_A_SMALL_THRUST_CONSTANT)
    assert named["thrust_constant"].parameters["ratio"].value == pytest.approx(0.9085, abs=0.01)
    assert "mass" in named["thrust_constant"].ambiguous_with


def test_an_inertia_that_explains_turbulence_is_a_torque_constant(tmp_path):
    """About x and y the controller's answer to turbulence looks like an inertia of 1.3, and left 7 % less of all motion
    than the truth: the torque constant was an inertia, by 98 % of the resamples. Slow motion shows which it is."""
    recorder = Recorder(50.0, noise=1.535)
    report = answered(Campaign(UNDER_TURBULENCE, {}, recorder, False, False, 9, 1156731661), tmp_path).report
    named = {effect.name: effect for effect in report.effects}
    assert set(named) <= set(UNDER_TURBULENCE)
    assert set(UNDER_TURBULENCE) - {"ground_effect"} <= set(named)
    assert named["torque_constant"].parameters["ratio"].value == pytest.approx(1.0785, abs=0.01)
