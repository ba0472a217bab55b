"""Paths that data names: below the folder of the data, or refused."""

from __future__ import annotations

from pathlib import Path, PurePosixPath


def path_inside(folder: Path, name: str) -> Path | None:
    """The path that a name leads to below a folder; None for one that leads elsewhere, or could.

    The name is relative and normal, without `..`, and stays in the folder when all links are followed. What it names
    need not exist.
    """
    if not name or "\0" in name or PurePosixPath(name).is_absolute() or str(PurePosixPath(name)) != name:
        return None
    parts = PurePosixPath(name).parts
    if not parts or ".." in parts:
        return None
    path = folder / name
    try:
        resolved, root = path.resolve(), folder.resolve()
    except (OSError, RuntimeError, ValueError):  # RuntimeError: links in a circle
        return None
    return path if resolved != root and resolved.is_relative_to(root) else None
