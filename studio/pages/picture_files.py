"""Pictures as files for papers: PDF, SVG and PNG, drawn by Kaleido in a Chromium of this machine, without a network."""

from __future__ import annotations

import asyncio
import copy
import json
import re
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from dynamics.errors import RequestError
from dynamics.files import make_folder
from dynamics.workbench_install import workbench_install
from studio.pages.figure import Picture

FORMATS = ("pdf", "svg", "png")
WIDTH = 700  # px at 96 dpi: the text's width on A4
SCALE = {"pdf": 1, "svg": 1, "png": 3}  # 288 dpi
TABS = 2  # of the browser, which draw at the same time
ADVICE = "Give another folder."


def write_pictures(pictures: Mapping[str, Picture], folder: Path) -> list[Path]:
    """Write each picture in each format, those with a menu once for each entry. Returns the files.

    Raises RequestError for a folder that cannot be written, and where Kaleido or a browser is missing.
    """
    make_folder(folder, advice=ADVICE)
    figures = dict(entry for name, picture in pictures.items() for entry in figures_of(name, picture))
    try:
        with tempfile.TemporaryDirectory(prefix=".alula-", dir=folder) as drawn:
            files = [Path(drawn, f"{name}.{kind}") for name in figures for kind in FORMATS]
            _draw([_request(figures[file.stem], file) for file in files])
            return [Path(shutil.move(file, folder / file.name)) for file in files]
    except OSError as error:
        raise RequestError(f"cannot write to {folder}: {error.strerror or error}. {ADVICE}") from error


def picture_pdf(figure: Mapping[str, Any], *, width: int, height: int) -> bytes:
    """A figure as one page of PDF. figure: `data` and `layout` of plotly; width, height: px at 96 dpi.

    Raises RequestError where Kaleido or a browser is missing, or the figure cannot be drawn.
    """
    with tempfile.TemporaryDirectory(prefix="alula-") as folder:
        file = Path(folder, "picture.pdf")
        options = {"format": "pdf", "width": width, "height": height, "scale": SCALE["pdf"]}
        _draw([{"fig": dict(figure), "path": str(file), "opts": options}])
        return file.read_bytes()


def figures_of(name: str, picture: Picture) -> Iterator[tuple[str, dict[str, Any]]]:
    """A picture's figures by the names of their files: one, or one for each entry of its menu."""
    figure = json.loads(picture.data)
    for trace in figure["data"]:
        trace["type"] = trace["type"].removesuffix("gl")  # drawn by a graphics card it would be no vectors
    choices = (figure["layout"].get("meta") or {}).get("choices", [])
    for choice in choices:
        shown = copy.deepcopy(figure)
        for trace, visible in zip(shown["data"], choice["visible"], strict=True):
            trace["visible"] = visible
        for place, value in choice["layout"].items():
            *parents, last = place.split(".")
            part = shown["layout"]
            for parent in parents:
                part = part.setdefault(parent, {})
            part[last] = value
        label = re.sub(r"[^a-z0-9]+", "_", choice["name"].lower()).strip("_")
        yield f"{name}_{label}", shown
    if not choices:
        yield name, figure


def _request(figure: dict[str, Any], file: Path) -> dict[str, Any]:
    kind = file.suffix[1:]
    size = {"width": WIDTH, "height": figure["layout"]["height"], "scale": SCALE[kind]}
    return {"fig": figure, "path": str(file), "opts": {"format": kind, **size}}


def _draw(requests: list[dict[str, Any]]) -> None:
    """Write files. Raises RequestError where that needs what is not installed, or a picture cannot be drawn."""
    try:
        from kaleido import Kaleido
        from kaleido.errors import BrowserFailedError, ChromeNotFoundError, KaleidoError
    except ModuleNotFoundError as error:
        raise RequestError(f"pictures as files need {error.name}: {workbench_install()}.") from error

    async def write() -> tuple[Exception, ...]:
        async with Kaleido(n=TABS, mathjax=False) as browser:  # by default it asks a network for MathJax
            failures: tuple[Exception, ...] = await browser.write_fig_from_object(requests)
            return failures

    try:
        failures = asyncio.run(write())
    except (ChromeNotFoundError, BrowserFailedError) as error:
        raise RequestError(
            f"pictures as files need Chromium or Chrome ({str(error).splitlines()[0]}). Install one, such as apt "
            "install chromium, or save the pictures from the page of --html."
        ) from error
    except KaleidoError as error:
        failures = (error,)
    if failures:
        raise RequestError(f"the browser could not draw a picture: {failures[0]}. Save it from the page of --html.")
