"""CITATION.cff says what pyproject.toml says, with the keys that the format requires."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML

from dynamics.version import __version__

ROOT = Path(__file__).parents[2]
CITATION: dict[str, Any] = YAML(typ="safe").load((ROOT / "CITATION.cff").read_text())
PROJECT: dict[str, Any] = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]


def test_required_keys_and_no_unknown_ones() -> None:
    allowed = {
        "cff-version",
        "message",
        "type",
        "title",
        "abstract",
        "authors",
        "version",
        "license",
        "keywords",
        "references",
    }
    assert {"cff-version", "message", "title", "authors"} <= set(CITATION) <= allowed
    assert CITATION["cff-version"] == "1.2.0"
    assert all(set(author) == {"name"} for author in CITATION["authors"])


def test_version_licence_and_authors_are_the_projects() -> None:
    assert str(CITATION["version"]) == PROJECT["version"] == __version__
    assert CITATION["license"] == PROJECT["license"]
    assert CITATION["authors"] == PROJECT["authors"]


def test_the_paper_is_referred_to() -> None:
    (paper,) = CITATION["references"]
    assert {"type", "title", "authors"} <= set(paper)
    assert [author["family-names"] for author in paper["authors"]] == ["Saviolo", "Li", "Loianno"]
    assert paper["doi"] == "10.1109/LRA.2022.3192609"
