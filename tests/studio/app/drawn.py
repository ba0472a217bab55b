"""Whether the pictures of a page are drawn, each by itself whatever its name, on a telephone's width and a screen's."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from playwright.sync_api import Error, Page

MIN_HEIGHT = 150  # px
MIN_PANEL = 30  # px that margins, titles and legends leave of each side of a panel
MAX_REACH = 0.75  # of the way from a scene's middle to its edge: the axes' labels are outside its box
WIDTHS = {390: 844, 1280: 900}  # px: height of the window
READY = """() => [...document.querySelectorAll('.js-plotly-plot')].filter(e => !e.closest('[hidden]')).every(
    e => e.calcdata && e.data.length && Math.abs(e.clientWidth - e._fullLayout.width) < 1)"""
STATES = """() => [...document.querySelectorAll('.js-plotly-plot')].filter(e => !e.closest('[hidden]')).map(
    e => [e.parentElement.id, !!e.calcdata, e.data && e.data.length, e.clientWidth, e._fullLayout.width])"""
MEASURED = Path(__file__).with_name("drawn.js").read_text(encoding="utf-8")


def require_drawn(page: Page, widths: Mapping[int, int] = WIDTHS) -> list[str]:
    """Fail where a picture of the page is flat, too wide, empty, cropped or without a legend. Returns their names.

    widths: of windows, px, each with its height; every change draws all pictures anew.
    """
    before = page.viewport_size
    names: list[str] = []
    for width, height in widths.items():
        page.set_viewport_size({"width": width, "height": height})
        _wait_until_drawn(page)
        plots: list[dict[str, Any]] = page.evaluate(MEASURED)
        faults = [f"{plot['name']} at {width} px: {fault}" for plot in plots for fault in faults_of(plot, width)]
        assert not faults, "\n".join(faults)
        names = [plot["name"] for plot in plots]
    if before is not None:
        page.set_viewport_size(before)
        _wait_until_drawn(page)
    return names


def _wait_until_drawn(page: Page) -> None:
    """Wait for all pictures; fail with the state of each where one stays undrawn."""
    try:
        page.wait_for_function(READY)
    except Error as error:
        raise AssertionError(f"not drawn: {page.evaluate(STATES)}") from error


def faults_of(plot: dict[str, Any], width: int) -> list[str]:
    """Faults of a plot in a window of that width, px."""
    faults = []
    if plot["height"] <= MIN_HEIGHT:
        faults.append(f"{plot['height']:.0f} px high")
    if plot["left"] < 0 or plot["right"] > width:
        faults.append(f"from {plot['left']:.0f} to {plot['right']:.0f} px")
    if not any(plot["values"]):
        faults.append(f"no points in {len(plot['values'])} traces")
    if any(length < MIN_PANEL for length in plot["panels"]):
        faults.append(f"a panel of {min(plot['panels']):.0f} px")
    if plot["unnamed"]:
        faults.append(f"no legend for {', '.join(map(str, plot['unnamed']))}")
    if any(reach > MAX_REACH for reach in plot["reaches"]):
        faults.append(f"its scene ends at {max(plot['reaches']):.2f} of the way to the edge")
    return faults
