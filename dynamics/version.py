"""The version of Alula, which every artefact records."""

from __future__ import annotations

from typing import Any

__version__ = "0.1.0"
VERSION_KEY = "alula_version"  # of every JSON that can be sent to somebody


def with_version(value: object) -> Any:
    """A value as plain data with the version: in the object that it is, or in each object of a list."""
    import msgspec  # which `import alula` does without

    plain = msgspec.to_builtins(value, str_keys=True)
    if isinstance(plain, dict):
        return {**plain, VERSION_KEY: __version__}
    if isinstance(plain, list | tuple):
        return [{**entry, VERSION_KEY: __version__} if isinstance(entry, dict) else entry for entry in plain]
    return plain
