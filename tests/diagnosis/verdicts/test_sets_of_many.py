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


def answered(campaign: Campaign, folder):
    (truths,) = flown([campaign])
    write_campaign(campaign, truths, folder)
    return alula.diagnose(sorted(map(str, folder.glob("*.csv"))), str(folder / "vehicle.toml"))


def test_what_was_refused_beside_an_open_force_is_judged_again_beside_its_rival(tmp_path):
    """A thrust constant stood for the mass and made the moments worse. Until the mass took its place the weight was
    open, beside which chance refused the torque constant: it was never named."""
    recorder = Recorder(100.0, noise=0.782)
    report = answered(Campaign(BESIDE_A_WRONG_MASS, {}, recorder, False, True, 9, 791206570), tmp_path).report
    found = {effect.name: effect for effect in report.effects}
    assert found["torque_constant"].parameters["ratio"].value == pytest.approx(1.2514, abs=0.01)
    assert found["rotor_cant"].parameters["tangential"].value == pytest.approx(-0.03546, rel=0.05)
    alike = [name for effect in report.effects for name in effect.ambiguous_with]
    assert "thrust_constant" in found["mass"].ambiguous_with
    assert len(alike) <= len(found)  # every rival of a small effect was declared, seven to an effect


def test_the_full_model_decides_between_all_rivals_where_something_is_left(tmp_path):
    """The columns preferred a thrust exponent to an inertia; beside it nothing held, and one of eight was named."""
    recorder = Recorder(400.0, noise=0.531)
    campaign = Campaign(WITH_A_LOOK_ALIKE_OF_INERTIA, {}, recorder, False, False, 9, 388477791)
    report = answered(campaign, tmp_path).report
    named = {effect.name for effect in report.effects}
    assert set(WITH_A_LOOK_ALIKE_OF_INERTIA) - {"ground_effect"} <= named
    assert named <= set(WITH_A_LOOK_ALIKE_OF_INERTIA)
    assert report.verdict in ("effect", "ambiguous")
