"""Tables of a result's folder: NumPy files that a page reads by memory map, however long the flights are."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray


def write_arrays(folder: Path, arrays: Mapping[str, NDArray[Any]]) -> None:
    """Write each array under its name."""
    for name, values in arrays.items():
        np.save(folder / f"{name}.npy", np.ascontiguousarray(values))


def read_array(folder: Path, name: str) -> NDArray[Any]:
    """An array of a result, without reading what is not looked at. Raises FileNotFoundError for an unknown name."""
    return np.load(folder / f"{name}.npy", mmap_mode="r")  # type: ignore[no-any-return]
