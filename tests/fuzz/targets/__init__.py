"""The targets by group; a group is fuzzed by one process, which imports what its readers need."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module

from tests.fuzz.target import Target

GROUPS = ("logs", "texts", "artefacts", "wire")


def targets_of(group: str) -> Mapping[str, Target]:
    """The targets of a group, by name; imported here, since only this group's process needs them.

    group: one of `GROUPS`, or the name of another module with TARGETS.
    """
    module = f"tests.fuzz.targets.{group}" if group in GROUPS else group
    targets: tuple[Target, ...] = import_module(module).TARGETS
    return {target.name: target for target in targets}
