"""How the workbench's libraries are installed: from Alula's own source or wheel, never by its name.

No package index holds Alula, so whoever registers the name there would be installed in its place.
"""

from __future__ import annotations

import json
import shlex
import tomllib
from importlib import metadata
from pathlib import Path
from urllib.parse import unquote, urlparse

ROOT = Path(__file__).resolve().parents[1]
EXTRA = "[workbench]"


def workbench_install() -> str:
    """The words of an advice: the command that installs the workbench, and where to run it."""
    place = _source()
    if place is not None:
        return f"pip install {shlex.quote(f'{place}{EXTRA}')}"
    return f"pip install '.{EXTRA}' in the folder of Alula's source"


def _source() -> Path | None:
    """The folder of the source, or the wheel, that this install was made from; None where it is no longer there."""
    if _is_source(ROOT):
        return ROOT
    origin = _origin()
    if origin is None or not (_is_source(origin) or (origin.is_file() and origin.suffix == ".whl")):
        return None
    return origin


def _origin() -> Path | None:
    """The local path that pip has installed from (PEP 610's direct_url.json); None for any other origin."""
    try:
        record = metadata.distribution("alula").read_text("direct_url.json")
    except metadata.PackageNotFoundError:
        return None
    try:
        address = urlparse(str(json.loads(record or "{}").get("url", "")))
    except (ValueError, AttributeError):
        return None
    return Path(unquote(address.path)) if address.scheme == "file" and address.path else None


def _is_source(folder: Path) -> bool:
    """Whether a folder holds Alula's source."""
    try:
        project = tomllib.loads((folder / "pyproject.toml").read_text(encoding="utf-8")).get("project", {})
    except (OSError, ValueError):
        return False
    return isinstance(project, dict) and project.get("name") == "alula"
