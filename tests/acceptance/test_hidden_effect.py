"""The user's own test: an effect is hidden, and the command line alone must identify it, add it, and be right.

The draws are those of one seed; ALULA_ACCEPTANCE_SEED=N takes another one. `python -m benchmarks demo draws` draws
random seeds. Of the draws `make test` tries one, `make test-all` each.
"""

import os
from functools import cache

import pytest

from fixtures.hidden_effect import Draw, Outcome, try_command_line, yardstick

DRAWS, MUST_HOLD = 3, 2
pytestmark = pytest.mark.timeout(1200)  # a draw takes 20 s of processor time, of which a busy machine gives a fraction
SEED = int(os.environ.get("ALULA_ACCEPTANCE_SEED", "1"))


@pytest.fixture(scope="module")
def outcome(tmp_path_factory):
    """The command line's outcome of a draw, by its number, each computed once; number -1 hides nothing."""
    measured = yardstick(SEED)

    @cache
    def computed(number: int) -> Outcome:
        draw = Draw.random(SEED, number) if number >= 0 else Draw("", 0.0, 1.0, SEED)
        return try_command_line(draw, measured, tmp_path_factory.mktemp("flights"))

    return computed


@pytest.fixture
def printed_outcome(outcome, capsys):
    """The same, printed even when the test passes."""

    def computed(number: int) -> Outcome:
        result = outcome(number)
        with capsys.disabled():
            print(f"\nALULA_ACCEPTANCE_SEED={SEED} {result}")
        return result

    return computed


@pytest.mark.long("nine flights")
def test_with_nothing_hidden_the_command_line_says_that_the_model_explains_the_flights(printed_outcome):
    result = printed_outcome(-1)
    assert result.faults == ()
    assert result.misses == ()
    assert result.added is None


@pytest.mark.long("nine flights, and three commands on them")
@pytest.mark.parametrize("number", [0, *(pytest.param(n, marks=pytest.mark.slow) for n in range(1, DRAWS))])
def test_no_draw_ends_in_an_error_or_a_worse_model(printed_outcome, number):
    assert printed_outcome(number).faults == ()


@pytest.mark.slow
def test_most_hidden_effects_are_located_named_and_added_until_only_noise_is_left(outcome):
    results = [outcome(number) for number in range(DRAWS)]
    held = [not (o.faults or o.misses) for o in results]
    assert sum(held) >= MUST_HOLD, "\n".join(map(str, results))
