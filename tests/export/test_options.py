"""What an export cannot be proven with is refused before anything is made."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

import alula
from dynamics.errors import RequestError


@pytest.mark.parametrize(
    ("wrong", "minimum"),
    [
        ({"windows": 1}, "10"),
        ({"windows": 0}, "10"),
        ({"seed": -1}, "0"),
        ({"nodes": 1}, "2"),
        ({"horizon": 0.01}, "0.1"),
    ],
)
def test_numbers_that_no_bundle_can_have_are_refused(tmp_path: Path, wrong: dict[str, Any], minimum: str) -> None:
    ((name, value),) = wrong.items()
    with pytest.raises(RequestError, match=rf"^{name} = {value}: wanted is {minimum} or more\. Give another"):
        alula.export("arpl_250g", tmp_path / "bundle", **wrong)
    assert not (tmp_path / "bundle").exists()
