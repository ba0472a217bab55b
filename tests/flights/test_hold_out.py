"""Which flights a pattern holds out, and where one flight is cut."""

from __future__ import annotations

import pytest

from dynamics.errors import RequestError
from flights.hold_out import cuts_in_time, matching

NAMES = ["one/log_1.csv", "one/log_2.csv", "two/log_1.csv"]


def test_a_pattern_matches_names_with_folders_or_without() -> None:
    assert matching(NAMES, "log_1*", option="--hold-out") == {0, 2}
    assert matching(NAMES, "two/*", option="--hold-out") == {2}


@pytest.mark.parametrize(("pattern", "which"), [("x*", "none"), ("*", "all")])
def test_a_pattern_that_matches_none_or_all_is_refused_with_the_option(pattern: str, which: str) -> None:
    with pytest.raises(RequestError, match=rf"--validation '.*' matches {which} of one/log_1.csv"):
        matching(NAMES, pattern, option="--validation")


def test_the_last_share_of_all_rows_is_cut_off_in_time() -> None:
    assert cuts_in_time([50, 30, 20], 0.2) == (50, 30, 0)
    assert cuts_in_time([100], 0.2) == (80,)
    assert cuts_in_time([10, 90], 0.5) == (10, 40)
