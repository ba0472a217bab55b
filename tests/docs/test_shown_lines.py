"""The comparison of lines that a page shows with what was printed tells other numbers from near ones."""

import pytest

from tests.support.shown_lines import Shown, blocks_of, is_printed

OUTPUT = """
┃ channel         ┃ before ┃ over floor ┃ flights ┃
│ accelerometer x │   1.44 │       6.35 │       2 │
│ angular x       │  0.971 │      0.968 │       2 │
The model misses linear_drag (coefficient = 1.935 ± 0.075 N s/m; 100 % of flight
resamples agree); drag2_4 from 32 s took 4.1 s, 12 MB, -58.1 % and 1.2e-05
"""


@pytest.mark.parametrize(
    "line",
    [
        "accelerometer x │ 1.44 │ 6.35 │ 2",
        "accelerometer x │ 1.45",
        "│ angular x │ 0.971 │",
        "coefficient = 1.94 ± 0.07 N s/m; 99 % of flight resamples",
        "drag2_4 from 33 s took 4.0 s, 12 MB, -57.0 % and 1.21e-05",
    ],
)
def test_near_numbers_are_the_ones_shown(line: str) -> None:
    assert is_printed(Shown(line), OUTPUT)


@pytest.mark.parametrize(
    "line",
    [
        "accelerometer x │ 1.60",
        "accelerometer x │ 1.44 │ 6.35 │ 3",
        "accelerometer x │ 6.35",
        "accelerometer │ 1.44",
        "accelerometer y │ 1.44",
        "coefficient = 2.1 ± 0.075",
        "coefficient = -1.935",
        "coefficient = 1.935 ± 0.12",
        "90 % of flight",
        "drag2_5 from 32 s",
        "drag2_4 from 40 s",
        "took 6.1 s",
        "4.1 s, 15 MB",
        "58.1 %",
        "1.5e-05",
        "coefficient = 1935",
        "nothing of the kind",
    ],
)
def test_other_numbers_are_not(line: str) -> None:
    assert not is_printed(Shown(line), OUTPUT)


def test_a_stated_tolerance_is_of_decimals_alone() -> None:
    assert is_printed(Shown("accelerometer x │ 1.60", 0.2), OUTPUT)
    assert not is_printed(Shown("accelerometer x │ 2.60", 0.2), OUTPUT)
    assert not is_printed(Shown("accelerometer x │ 1.44 │ 6.35 │ 3", 0.9), OUTPUT)


def test_a_comment_before_a_block_states_its_tolerance() -> None:
    comment = "<!-- numbers within 40 %: it flies against the clock -->"
    page = f"```sh\nrun\n```\n\n{comment}\n```text\n1.0\n```\n```text\n2\n```\n"
    assert list(blocks_of(page)) == [("sh", "run\n", None), ("text", "1.0\n", 0.4), ("text", "2\n", None)]
