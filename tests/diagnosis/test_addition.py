"""What is added when no effect is named, the notes that come with it, and why an effect is refused."""

from dataclasses import replace
from types import SimpleNamespace

import msgspec
import numpy as np
import pytest

from diagnosis.addition import _borne_out, add_effect, notes_of_set
from diagnosis.addition_report import report
from diagnosis.by_likelihood import noise_of
from diagnosis.data.dataset import make_dataset
from diagnosis.estimation.acceptance import Accepted
from diagnosis.estimation.fitted import Fit, ParameterEstimate, with_candidates
from diagnosis.estimation.held_out import HeldOut
from diagnosis.report import Diagnosis, MissingEffect
from dynamics.effects import CATALOGUE
from dynamics.errors import DataError
from dynamics.vehicle import EffectUse

SOME = {n: CATALOGUE[n] for n in ("wind", "imu_bias", "gyro_bias", "time_delay")}


def diagnosed(verdict: str, *effects: MissingEffect) -> Diagnosis:
    return Diagnosis(verdict, effects, {}, (), (), "fly yaw spins")


def missing(name: str, *, rotor: int | None = None, rivals: tuple[str, ...] = ()) -> MissingEffect:
    return MissingEffect(name, rotor, {}, 1.0, rivals)


def test_what_is_doubtful_about_the_effects_is_noted():
    notes = notes_of_set(diagnosed("ambiguous", missing("mass", rivals=("thrust_constant",)), missing("rotor_drag")))
    assert "cannot tell mass from thrust_constant" in notes[0]
    assert "fly yaw spins" in notes[0]
    assert len(notes) == 1
    notes = notes_of_set(diagnosed("unknown", missing("mass"), missing("rotor_drag")))
    assert "mass, rotor_drag: a part of what is missing at most" in notes[0]


def test_a_gust_is_passed_over_for_what_a_vehicle_file_can_hold():
    notes = notes_of_set(diagnosed("effect", missing("gust"), missing("mass")))
    assert "gust" in notes[0]


@pytest.mark.parametrize(
    ("diagnosis", "reason"),
    [
        (diagnosed("explained"), "the model explains these flights"),
        (diagnosed("effect", missing("gust")), "no value in a vehicle file predicts it"),
        (diagnosed("unknown"), "no effect of the catalogue explains it"),
    ],
)
def test_nothing_is_added_where_a_diagnosis_names_nothing_that_could_be(diagnosis, reason):
    with pytest.raises(DataError, match=reason):
        notes_of_set(diagnosis)


def test_a_wind_that_the_file_overstates_is_corrected_and_its_ambiguity_noted(plain_flights, arpl_250g):
    windy = arpl_250g.with_effects(EffectUse("wind", {"x": 1.5, "y": 0.0, "z": 0.0}))
    added = add_effect("wind", make_dataset(plain_flights, windy), windy, SOME, date="2026-01-02")
    assert added.vehicle.effects[0].parameters["x"] == pytest.approx(0.0, abs=0.03)
    assert added.chi_square[1] < 0.5 * added.chi_square[0]
    before, after = (errors[2] for errors in added.open_loop)
    assert before.horizon == after.horizon == 1.0
    assert after.velocity < before.velocity
    assert any("velocity x coefficient" in note for note in added.notes)
    answer = msgspec.to_builtins(report(added))
    assert answer["effect"] == "wind"
    assert answer["parameters"]["wind"]["x"]["unit"] == "m/s"


def rotor_drag(vehicle, dataset, *, of_file, fitted):
    """What a diagnosis accepted: a drag of the file that a fit has moved, surely by its interval."""
    some = {n: CATALOGUE[n] for n in ("rotor_drag", "imu_bias", "gyro_bias", "time_delay")}
    dragging = vehicle.with_effects(EffectUse("rotor_drag", {"coefficient": of_file}))
    noise = noise_of(dataset, dragging, some)
    drag = next(c for c in noise.problems[0].what.all if c.effect.name == "rotor_drag")
    vehicle = with_candidates(dragging, [drag], {"rotor_drag.coefficient": fitted})
    estimates = {("rotor_drag", "coefficient"): ParameterEstimate(fitted, 1e-9, "")}
    fit = Fit(vehicle, estimates, (drag,), np.array([[1e-18]]), information=np.array([[1e18]]))
    return Accepted(fit, ()), noise


def answered(noise, accepted):
    """An answer with these effects, of which nothing is left where one is taken back."""
    fewer = replace(accepted, fit=replace(accepted.fit, estimates={}, candidates=()))

    def without(refused):
        return SimpleNamespace(noise=noise, accepted=replace(fewer, refused=tuple(refused)))

    return SimpleNamespace(noise=noise, accepted=accepted, without=without)


@pytest.mark.parametrize(("of_file", "written"), [(0.0, False), (8e-6, True)])
def test_what_makes_no_open_loop_better_is_not_written_however_sure_it_is(plain_flights, arpl_250g, of_file, written):
    """With nothing hidden a drag of 0.973 was written in place of 1, and the position after a second erred by more."""
    dataset = make_dataset(plain_flights, arpl_250g)
    accepted, noise = rotor_drag(arpl_250g, dataset, of_file=of_file, fitted=3e-7)
    judge = HeldOut(noise, dataset.held_out)
    answer = answered(noise, accepted)
    if written:
        assert _borne_out(answer, judge).accepted.fit.keys == ("rotor_drag",)
    else:
        with pytest.raises(DataError, match=r"nothing was added: rotor_drag .* not better with it by more than chance"):
            _borne_out(answer, judge)
