"""Accepted effects are exchanged for those of which slow motion leaves less, one or two at once."""

from dataclasses import dataclass
from types import SimpleNamespace

import pytest

from diagnosis.data.dataset import make_dataset
from diagnosis.estimation import exchanges
from diagnosis.estimation.equation_error import fit
from diagnosis.estimation.slow_motion import SlowMotion
from diagnosis.selection.regression_of_flights import make_regression
from diagnosis.thresholds import DEFAULT
from dynamics.effects import CATALOGUE
from dynamics.vehicle import EffectUse
from fixtures.planted import planted_flights
from tests.diagnosis.conftest import MANOEUVRES

MASS, THRUST, TORQUE, DAMPING, INERTIA = "mass", "thrust_constant", "torque_constant", "rotational_damping", "inertia"
LEFT = {  # by slow motion, of the joint fits
    frozenset({MASS, TORQUE}): 2900.0,
    frozenset({THRUST, TORQUE}): 2950.0,
    frozenset({MASS, DAMPING}): 4000.0,
    frozenset({THRUST, DAMPING}): 70.0,
}
CHI_SQUARE: dict[frozenset[str], float] = {}
NAMES = (MASS, THRUST, TORQUE, DAMPING, INERTIA)


def candidate(name):
    alike = {MASS: (THRUST,), THRUST: (MASS,), TORQUE: (INERTIA,)}.get(name, ())
    return SimpleNamespace(
        key=name, effect=SimpleNamespace(name=name, confounded_with=alike), columns=(NAMES.index(name),)
    )


REGRESSION = SimpleNamespace(candidates=tuple(map(candidate, NAMES)), nuisances=(), thresholds=DEFAULT, total=1000)


def of(*names):
    return tuple(c for c in REGRESSION.candidates if c.key in names)


@dataclass(frozen=True, eq=False)
class Joint:
    candidates: tuple
    keys: tuple[str, ...]
    unsettled: frozenset[str]
    chi_square: float


def fitted(*names):
    keys = frozenset(names)
    return Joint(of(*names), tuple(keys), frozenset(), CHI_SQUARE.get(keys, 1.0))


@pytest.fixture
def proposed(monkeypatch):
    """Sets that columns propose about each fit, by its effects."""
    sets: dict[frozenset[str], list[tuple[str, ...]]] = {}

    class Slow:
        count = 80

        def left(self, fitted, vehicle):
            return LEFT.get(frozenset(fitted.keys), 9000.0)

    class Search:
        thresholds = DEFAULT.search

        def __init__(self, regression, about=frozenset()):
            self.regression, self.about = REGRESSION, about

        def penalty(self, candidate):
            return 10.0

        def near(self, chosen):
            return [SimpleNamespace(candidates=of(*names)) for names in sets.get(self.about, [])]

        def merged(self, chosen):
            return [scored for scored in self.near(chosen) if len(scored.candidates) < len(self.about)]

    def joint(regression, some, vehicle, level):
        return fitted(*(c.key for c in some))

    def rivals_of(search, others, chosen):
        taken = {chosen.key, *(c.key for c in others)}
        rivals = [c for c in REGRESSION.candidates if c.key not in taken]
        return [SimpleNamespace(candidates=(*others, c)) for c in (chosen, *rivals)]

    monkeypatch.setattr(exchanges, "SlowMotion", lambda regression: Slow())
    monkeypatch.setattr(exchanges, "Search", Search)
    monkeypatch.setattr(exchanges, "_search_about", lambda regression, start: Search(None, frozenset(start.keys)))
    monkeypatch.setattr(exchanges, "fit", joint)
    monkeypatch.setattr(exchanges, "rivals_of", rivals_of)
    monkeypatch.setattr(exchanges, "scales_rotors", lambda candidate: candidate.key != DAMPING)
    return sets


def exchanged(monkeypatch, judge=lambda names: names, **options):
    def judged(regression, candidates, dataset, vehicle, refused):
        return SimpleNamespace(fit=fitted(*judge({c.key for c in candidates})), refused=refused)

    monkeypatch.setattr(exchanges, "judged_fit", judged)
    accepted = SimpleNamespace(fit=fitted(MASS, TORQUE), refused=())
    return set(exchanges.with_exchanges(REGRESSION, accepted, None, None, **options).fit.keys)


def test_two_are_exchanged_at_once_where_either_alone_leaves_more(proposed, monkeypatch):
    proposed[frozenset({MASS, TORQUE})] = [(THRUST, DAMPING), (MASS, INERTIA)]
    assert exchanged(monkeypatch) == {THRUST, DAMPING}


def test_of_what_columns_propose_the_set_counts_that_leaves_least_in_the_full_model(proposed, monkeypatch):
    monkeypatch.setitem(LEFT, frozenset({MASS, INERTIA}), 500.0)
    proposed[frozenset({MASS, TORQUE})] = [(MASS, INERTIA), (THRUST, DAMPING)]
    assert exchanged(monkeypatch) == {THRUST, DAMPING}


def test_it_goes_on_from_each_step_and_what_is_small_may_be_refused_in_the_end(proposed, monkeypatch):
    """An exchange that is right beside an effect that is too small to name is found beside that effect."""
    monkeypatch.setitem(LEFT, frozenset({MASS, TORQUE, INERTIA}), 400.0)
    monkeypatch.setitem(LEFT, frozenset({THRUST, DAMPING, INERTIA}), 60.0)
    proposed[frozenset({MASS, TORQUE})] = [(MASS, TORQUE, INERTIA)]
    proposed[frozenset({MASS, TORQUE, INERTIA})] = [(THRUST, DAMPING, INERTIA)]
    assert exchanged(monkeypatch, judge=lambda names: names - {INERTIA}) == {THRUST, DAMPING}


def test_what_stands_in_for_an_effect_that_is_refused_is_no_exchange(proposed, monkeypatch):
    monkeypatch.setitem(LEFT, frozenset({MASS, TORQUE, INERTIA}), 60.0)
    monkeypatch.setitem(LEFT, frozenset({MASS, DAMPING}), 600.0)
    proposed[frozenset({MASS, TORQUE})] = [(MASS, DAMPING), (MASS, TORQUE, INERTIA)]
    assert exchanged(monkeypatch, judge=lambda names: names - {INERTIA}) == {MASS, TORQUE}


@pytest.mark.parametrize(("left", "in_gust", "named"), [(60.0, False, THRUST), (95.0, False, MASS), (60.0, True, MASS)])
def test_slow_motion_decides_between_what_scales_the_rotors_and_its_look_alike(
    proposed, monkeypatch, left, in_gust, named
):
    """Turbulence makes moments look too small, so that all motion prefers the mass to a constant above one."""
    monkeypatch.setitem(LEFT, frozenset({MASS, TORQUE}), 100.0)
    monkeypatch.setitem(LEFT, frozenset({THRUST, TORQUE}), left)
    assert exchanged(monkeypatch, in_gust=in_gust) == {named, TORQUE}


def test_what_held_out_flights_refuse_is_not_exchanged(proposed, monkeypatch):
    proposed[frozenset({MASS, TORQUE})] = [(THRUST, DAMPING)]
    assert exchanged(monkeypatch, judge=lambda names: names - {DAMPING}) == {MASS, TORQUE}


def test_a_set_of_which_held_out_flights_leave_nothing_is_no_exchange(proposed, monkeypatch):
    """Slow motion is not asked about no effect at all: that raised an error."""
    monkeypatch.setattr(exchanges._Walk, "_left", lambda self, fitted: LEFT[frozenset(fitted.keys)])
    proposed[frozenset({MASS, TORQUE})] = [(THRUST, DAMPING)]
    assert exchanged(monkeypatch, judge=lambda names: names - {THRUST, DAMPING}) == {MASS, TORQUE}


def test_what_leaves_little_less_is_not_exchanged(proposed, monkeypatch):
    monkeypatch.setitem(LEFT, frozenset({THRUST, DAMPING}), 2700.0)
    proposed[frozenset({MASS, TORQUE})] = [(THRUST, DAMPING)]
    assert exchanged(monkeypatch) == {MASS, TORQUE}


def test_a_set_that_slow_motion_refutes_as_well_is_not_taken(proposed, monkeypatch):
    monkeypatch.setitem(LEFT, frozenset({THRUST, DAMPING}), 161.0)
    proposed[frozenset({MASS, TORQUE})] = [(THRUST, DAMPING)]
    assert exchanged(monkeypatch) == {MASS, TORQUE}


def test_where_slow_motion_leaves_little_more_than_chance_nothing_is_tried(proposed, monkeypatch):
    monkeypatch.setitem(LEFT, frozenset({MASS, TORQUE}), 160.0)
    monkeypatch.setitem(LEFT, frozenset({THRUST, DAMPING}), 1.0)
    proposed[frozenset({MASS, TORQUE})] = [(THRUST, DAMPING)]
    assert exchanged(monkeypatch) == {MASS, TORQUE}


def test_two_effects_that_slow_motion_does_not_refute_may_be_one_of_another_name(proposed, monkeypatch):
    monkeypatch.setitem(LEFT, frozenset({MASS, TORQUE}), 160.0)
    monkeypatch.setitem(LEFT, frozenset({THRUST}), 150.0)
    proposed[frozenset({MASS, TORQUE})] = [(THRUST, DAMPING), (THRUST,)]
    assert exchanged(monkeypatch) == {THRUST}
    monkeypatch.setitem(CHI_SQUARE, frozenset({THRUST}), 1.02)  # of 1000: more than the one that is saved costs
    assert exchanged(monkeypatch) == {MASS, TORQUE}


def test_in_a_gust_which_refutes_any_set_effects_are_merged_alone(proposed, monkeypatch):
    monkeypatch.setitem(LEFT, frozenset({THRUST}), 2500.0)
    proposed[frozenset({MASS, TORQUE})] = [(THRUST, DAMPING)]
    assert exchanged(monkeypatch, in_gust=True) == {MASS, TORQUE}
    proposed[frozenset({MASS, TORQUE})] = [(THRUST, DAMPING), (THRUST,)]
    assert exchanged(monkeypatch, in_gust=True) == {THRUST}


@pytest.fixture(scope="module")
def damped(arpl_250g):
    """The regression of flights on a vehicle whose file lacks a strong damping."""
    planted = [EffectUse(DAMPING, {"coefficient": 5e-4})]
    dataset = make_dataset(planted_flights(arpl_250g, planted, seed=11, manoeuvres=MANOEUVRES), arpl_250g)
    return make_regression(arpl_250g, CATALOGUE, dataset.fitted, dataset.flight_of)


def test_slow_motion_leaves_about_as_much_of_the_right_model_as_there_are_columns(damped, arpl_250g):
    slow = SlowMotion(damped)
    right, wrong = (
        fit(damped, [next(c for c in damped.candidates if c.effect.name == name)]) for name in (DAMPING, TORQUE)
    )
    assert slow.left(right, arpl_250g) < 2 * slow.count
    assert slow.left(wrong, arpl_250g) > 10 * slow.count


def test_by_slow_motion_a_torque_constant_is_no_damping(damped):
    """Columns for detection have the moments of the motion in place of the rotors': a damping takes its own off it."""
    search = exchanges.Search(SlowMotion(damped).regression())
    damping, both = (
        search.score([c for c in damped.candidates if c.effect.name in names])
        for names in ({DAMPING}, {DAMPING, TORQUE})
    )
    assert both.score < damping.score
    assert damping.gain == pytest.approx(both.gain, rel=1e-3)
