"""Pages in a headless Chromium that reaches no network."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

BROWSER = next(
    (path for name in ("chromium", "chromium-browser", "google-chrome") if (path := shutil.which(name))), None
)
OPTIONS = (
    "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync", "--use-gl=swiftshader", "--enable-unsafe-swiftshader",
    "--proxy-server=127.0.0.1:9",
)  # fmt: skip
PATIENCE = 200_000.0  # ms
needs_browser = pytest.mark.skipif(
    BROWSER is None and os.environ.get("CI") != "true", reason="no Chromium here; CI has one"
)


@contextmanager
def browser() -> Iterator[Any]:
    """A browser of Playwright's."""
    from playwright.sync_api import sync_playwright

    assert BROWSER is not None, "CI must have Chromium"
    with sync_playwright() as playwright:
        started = playwright.chromium.launch(executable_path=BROWSER, args=list(OPTIONS), timeout=PATIENCE)
        try:
            yield started
        finally:
            started.close()


@contextmanager
def drawn_page(started: Any, path: Path, *, width: int = 1280, dark: bool = False) -> Iterator[Any]:
    """A page of a file whose pictures are drawn; its errors, and what it asked a network for, fail the test."""
    context = started.new_context(viewport={"width": width, "height": 900}, color_scheme="dark" if dark else "light")
    wrong: list[str] = []
    try:
        page = context.new_page()
        page.on("pageerror", lambda error: wrong.append(str(error)))
        page.on("console", lambda message: wrong.append(message.text) if message.type == "error" else None)
        page.on("request", lambda request: wrong.append(request.url) if request.url.startswith("http") else None)
        page.goto(path.as_uri(), timeout=PATIENCE)
        page.wait_for_function("document.documentElement.dataset.drawn", timeout=PATIENCE)
        yield page
    finally:
        context.close()
    assert wrong == []
