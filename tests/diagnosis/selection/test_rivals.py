"""Effects whose signals are nearly the same are rivals, others are not."""

from dataclasses import replace

import numpy as np

from diagnosis.selection.rivals import look_alikes, near_rivals, rivals_of, to_fit
from diagnosis.selection.search import IMPOSSIBLE, Search
from tests.diagnosis.synthetic import CHANNELS, candidate, effect, hovering, regression


def searched(vehicle, *, difference: float, seed: int = 0) -> Search:
    """a is planted; b has the same column but for a difference; c is another one."""
    random = np.random.default_rng(seed)
    columns = [random.standard_normal((80, CHANNELS, 3)) for _ in range(6)]
    for x in columns:
        x[:, :, 1] = x[:, :, 0] + difference * x[:, :, 1]
    rows = [0.3 * x[:, :, 0] + random.standard_normal((80, CHANNELS)) for x in columns]
    candidates = [candidate(effect(name), i) for i, name in enumerate("abc")]
    segments = hovering(vehicle, mass_ratio=1.0, seed=0)
    return Search(regression(vehicle, candidates, columns, rows, segments=segments))


def names(rivals) -> list[str]:
    return [s.candidates[-1].key for s in rivals]


def test_an_effect_with_nearly_the_same_signal_cannot_be_told_apart(arpl_250g):
    search = searched(arpl_250g, difference=0.05)
    rivals = rivals_of(search, [], search.regression.candidates[0])
    assert names(rivals)[:2] == ["a", "b"]
    assert names(near_rivals(search, [], rivals)) == ["b"]


def test_an_effect_with_another_signal_can(arpl_250g):
    search = searched(arpl_250g, difference=1.0)
    rivals = rivals_of(search, [], search.regression.candidates[0])
    assert names(near_rivals(search, [], rivals)) == []


def test_beside_much_else_what_leaves_a_half_of_a_small_effect_does_not_look_like_it(arpl_250g):
    """The columns' error, a share of what the whole set explains, is more than the small effect."""
    random = np.random.default_rng(3)
    columns = [random.standard_normal((80, CHANNELS, 3)) for _ in range(6)]
    for x in columns:
        x[:, :, 2] = x[:, :, 1] + x[:, :, 2]
    rows = [x[:, :, :2] @ [5.0, 0.3] + random.standard_normal((80, CHANNELS)) for x in columns]
    candidates = [candidate(effect(name), i) for i, name in enumerate("abc")]
    search = Search(
        regression(arpl_250g, candidates, columns, rows, segments=hovering(arpl_250g, mass_ratio=1.0, seed=0))
    )
    a, b, _ = search.regression.candidates
    rivals = rivals_of(search, [a], b)
    assert names(near_rivals(search, [a], rivals)) == ["c"]
    assert names(look_alikes(search, [a], rivals)) == []


def test_an_effect_that_is_chosen_already_is_no_rival(arpl_250g):
    search = searched(arpl_250g, difference=0.05)
    a, _, c = search.regression.candidates
    assert "c" not in names(rivals_of(search, [c], a)[1:])


def test_with_commands_what_explains_less_is_no_rival_where_the_others_alone_are_impossible(arpl_250g):
    """a pushes against b, so that without b its coefficient is impossible. c explains two thirds of b."""
    random = np.random.default_rng(2)
    columns = [random.standard_normal((80, CHANNELS, 3)) for _ in range(6)]
    for x in columns:
        x[:, :, 1] += 0.5 * x[:, :, 0]
        x[:, :, 2] = x[:, :, 1] + 0.7 * x[:, :, 2]
    rows = [x[:, :, :2] @ [0.15, -0.4] + 0.1 * random.standard_normal((80, CHANNELS)) for x in columns]
    candidates = [candidate(effect("a", lowest=0.0), 0), *(candidate(effect(n), i) for i, n in ((1, "b"), (2, "c")))]
    segments = [replace(s, rotor_source="command") for s in hovering(arpl_250g, mass_ratio=1.0, seed=0)]
    search = Search(regression(arpl_250g, candidates, columns, rows, segments=segments))
    a, b, _ = candidates
    assert search.score([a]).score == IMPOSSIBLE
    rivals = rivals_of(search, [a], b)
    assert names(rivals) == ["b", "c"]
    assert near_rivals(search, [a], rivals) == []


def test_as_many_as_look_alike_are_declared(arpl_250g):
    random = np.random.default_rng(1)
    columns = [np.repeat(random.standard_normal((80, CHANNELS, 1)), 5, axis=2) for _ in range(6)]
    columns = [x + 0.05 * random.standard_normal(x.shape) for x in columns]
    rows = [0.3 * x[:, :, 0] + random.standard_normal((80, CHANNELS)) for x in columns]
    candidates = [candidate(effect(name), i) for i, name in enumerate("abcde")]
    segments = hovering(arpl_250g, mass_ratio=1.0, seed=0)
    search = Search(regression(arpl_250g, candidates, columns, rows, segments=segments))
    rivals = rivals_of(search, [], search.regression.candidates[0])
    assert sorted(names(near_rivals(search, [], rivals))) == ["b", "c", "d", "e"]


def test_what_is_akin_is_fitted_however_many_are_nearer(arpl_250g):
    """Seven of nine nearer effects are kept, two of them are fitted, and so is the one that is declared alike."""
    random = np.random.default_rng(5)
    columns = [random.standard_normal((80, CHANNELS, 11)) for _ in range(6)]
    for x in columns:
        for place in range(1, 11):
            x[:, :, place] = x[:, :, 0] + (0.05 if place == 10 else 0.005) * x[:, :, place]
    rows = [2.0 * x[:, :, 0] + random.standard_normal((80, CHANNELS)) for x in columns]
    effects = [effect(name) for name in "abcdefghijk"]
    effects[-1] = replace(effects[-1], confounded_with=("a",))
    candidates = [candidate(one, i) for i, one in enumerate(effects)]
    segments = hovering(arpl_250g, mass_ratio=1.0, seed=0)
    search = Search(regression(arpl_250g, candidates, columns, rows, segments=segments))
    a = search.regression.candidates[0]
    rivals = rivals_of(search, [], a)
    assert "k" in names(rivals)
    assert len(rivals) == 1 + search.regression.thresholds.rivals.max_rivals + 1
    near = near_rivals(search, [], rivals)
    assert names(to_fit(near, a, 2)) == [*names(near)[:2], "k"]
