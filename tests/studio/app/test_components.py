"""Components of the pages get properties that they have: a wrong one fails only when its page is drawn."""

from __future__ import annotations

import ast
import inspect
from collections.abc import Iterator
from pathlib import Path

import dash_ag_grid as dag
import dash_mantine_components as dmc
from dash import dcc, html

import studio.app

LIBRARIES = {"dag": dag, "dcc": dcc, "dmc": dmc, "html": html}


def _calls() -> Iterator[tuple[str, str, str, list[str]]]:
    """Place, library, component and names of properties of every component that a page's code makes."""
    for path in Path(next(iter(studio.app.__path__))).glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if (
                isinstance(node, ast.Call)
                and isinstance(node.func, ast.Attribute)
                and isinstance(node.func.value, ast.Name)
                and node.func.value.id in LIBRARIES
            ):
                names = [word.arg for word in node.keywords if word.arg is not None]
                yield f"{path.name}:{node.lineno}", node.func.value.id, node.func.attr, names


def test_every_property_of_a_component_exists() -> None:
    calls = list(_calls())
    assert len(calls) > 100
    wrong = []
    for place, library, name, properties in calls:
        declared = inspect.signature(getattr(LIBRARIES[library], name).__init__).parameters
        wrong += [f"{place}: {library}.{name} has no {one}" for one in properties if one not in declared]
    assert wrong == []
