"""Second cases of a property: `make test-all` runs them, `make test` what guards the property beside them.

tests/nightly.toml lists them by the beginnings of their names, each group with the tests that guard the same in every
run. A name or a guard that is no test any more, or a guard that is slow itself, refuses the run.
"""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

TESTS = Path(__file__).parents[1]
TABLE = TESTS / "nightly.toml"


def read_table(path: Path = TABLE) -> list[dict[str, Any]]:
    """Groups of tests, with `tests`, `guards` and `why` each."""
    return list(tomllib.loads(path.read_text(encoding="utf-8"))["group"])


def mark(items: Sequence[pytest.Item], table: Sequence[dict[str, Any]], root: Path = TESTS, *, complete: bool) -> None:
    """Mark what the table lists as slow. complete: items are all tests of their files.

    Raises UsageError where a file of the items lacks a test that the table names, or a guard is slow.
    """
    named = {name_of(item, root): item for item in items}
    files = {name.split("::")[0] for name in named}
    faults = []

    def matching(name: str, purpose: str = "") -> list[pytest.Item]:
        matches = [item for other, item in named.items() if other.startswith(name)]
        if complete and not matches and name.split("::")[0] in files:
            faults.append(f"no test is named {name}{purpose}")
        return matches

    for group in table:
        for name in group["tests"]:
            for item in matching(name):
                item.add_marker(pytest.mark.slow)
    for group in table:  # once all are marked
        purpose = f"to guard {group['tests'][0]}"
        for name in group["guards"]:
            matches = matching(name, f", which is {purpose}")
            if matches and all(item.get_closest_marker("slow") for item in matches):
                faults.append(f"{name} is slow, and is {purpose} in every run")
    if faults:
        raise pytest.UsageError(f"{TABLE.name}: {'; '.join(faults)}")


def name_of(item: pytest.Item, root: Path = TESTS) -> str:
    """File below the folder of tests, and name."""
    return f"{item.path.relative_to(root).as_posix()}::{item.nodeid.split('::', 1)[1]}"


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Mark the table's tests before slow ones are left out."""
    ours = [item for item in items if TESTS in item.path.parents]
    mark(ours, read_table(), complete=not any("::" in argument for argument in config.args))
