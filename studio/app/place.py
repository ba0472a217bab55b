"""Where a page stands: the case, the step or the result that an address names."""

from __future__ import annotations

from pathlib import Path

from dynamics.errors import AlulaError
from studio.app.opened import PAGES, OpenCase, Result
from studio.app.studio import Studio


def place_of(path: str | None) -> tuple[str, str]:
    """Case and page of an address, empty for an address that is no case's."""
    parts = [part for part in (path or "").split("/") if part]
    if len(parts) < 2 or parts[0] != "case":
        return "", ""
    page = parts[2] if len(parts) > 2 and parts[2] in PAGES else "log"
    return parts[1], page


def result_of(path: str | None) -> str:
    """The result of an address, empty for an address that is no result's."""
    parts = [part for part in (path or "").split("/") if part]
    return parts[1] if len(parts) == 2 and parts[0] == "result" else ""


def opened_at(studio: Studio, path: str | None) -> OpenCase | None:
    """The case of an address; None for none, or one that cannot be opened."""
    name, _ = place_of(path)
    try:
        return studio.case(name) if name else None
    except AlulaError:
        return None


def result_at(studio: Studio, path: str | None, kind: type[Result], step: str) -> tuple[OpenCase, Result, Path] | None:
    """The case of an address with the result of a step that is shown, and its folder; None where there is none."""
    opened = opened_at(studio, path)
    if opened is None:
        return None
    result, folder = opened.result(kind, step), opened.case.shown_result(step)
    return None if result is None or folder is None else (opened, result, folder)
