"""The tutorial from a log to a named effect can be followed, and shows what is printed."""

from pathlib import Path

import pytest

from tests.support.tutorial import TUTORIALS, follow, prepare


@pytest.mark.long("follows the whole page")
def test_every_step_works_and_prints_what_is_shown(tmp_path: Path) -> None:
    prepare(tmp_path)
    follow(TUTORIALS / "log_to_effect.md", tmp_path, against_clock=False)
