"""Rendering of pages: HTML files with style, pictures and provenance, readable without a network or JavaScript."""

from __future__ import annotations

import base64
import gzip
import json
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

import jinja2
from plotly import offline

from diagnosis.models.channels import channel_name
from diagnosis.report import refusal_sentence, remains, score_sentence
from dynamics.files import write_whole
from studio.pages.colours import DARK
from studio.pages.numbers import quantity_shown, shown, unit_shown

TEMPLATES = Path(__file__).parent / "templates"
PACKAGES = ("alula", "numpy", "scipy", "casadi")


@dataclass(frozen=True)
class Origin:
    """Origin of a page.

    command: that made it.
    made: date and time, UTC.
    inputs: sha256 of each file that was read, by path.
    add: the command that adds the named effect, empty where there is none to add.
    held_out: those of the files that nothing was fitted to.
    """

    command: str = ""
    made: str = ""
    inputs: Mapping[str, str] = field(default_factory=dict)
    add: str = ""
    held_out: Collection[str] = ()


def render(template: str, *, title: str, origin: Origin, **content: Any) -> str:
    """A page from a template of `studio/pages/templates`, as HTML."""
    versions = {name: metadata.version(name) for name in PACKAGES}
    page: str = (
        _environment()
        .get_template(template)
        .render(
            title=title, origin=origin, versions=versions, plotly=_packed_plotly(), dark=embedded(dict(DARK)), **content
        )
    )
    return page


def write_page(text: str, path: Path) -> None:
    """Write a page under a temporary name, then rename it. Raises RequestError when it cannot be written."""
    write_whole(path, lambda part: part.write_text(text, encoding="utf-8"), advice="Give another file to --html.")


def embedded(value: Any) -> str:
    """JSON that is safe inside a script element, whatever its texts contain."""
    text = value if isinstance(value, str) else json.dumps(value, allow_nan=False)
    return text.replace("<", "\\u003c")


@cache
def _environment() -> jinja2.Environment:
    loader = jinja2.FileSystemLoader(TEMPLATES)
    environment = jinja2.Environment(
        loader=loader, autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters["shown"] = shown
    environment.filters["unit"] = unit_shown
    environment.filters["quantity"] = quantity_shown
    environment.filters["filename"] = lambda path: Path(path).name
    environment.filters["channel"] = channel_name
    environment.filters["remains"] = remains
    environment.filters["refusal"] = refusal_sentence
    environment.filters["score"] = score_sentence
    return environment


@cache
def _packed_plotly() -> str:
    """plotly.js, gzip and base64: 2 MB instead of 4.8, inflated by the browser."""
    return base64.b64encode(gzip.compress(offline.get_plotlyjs().encode(), mtime=0)).decode()
