"""Tables of a result's folder: NumPy files that a page reads by memory map, however long the flights are."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynamics.array_file import DAMAGE
from dynamics.errors import RequestError


def write_arrays(folder: Path, arrays: Mapping[str, NDArray[Any]]) -> None:
    """Write each array under its name."""
    for name, values in arrays.items():
        np.save(folder / f"{name}.npy", np.ascontiguousarray(values))


def read_array(folder: Path, name: str) -> NDArray[Any]:
    """An array of a result, without reading what is not looked at.

    Raises FileNotFoundError for an unknown name, RequestError for a file that is damaged or cut off.
    """
    path = folder / f"{name}.npy"
    try:
        return np.lib.format.open_memmap(path, mode="r")
    except FileNotFoundError:
        raise
    except DAMAGE as error:
        raise RequestError(
            f"{path} is damaged: {str(error) or type(error).__name__}. Delete the folder {folder}; the step that wrote "
            "it is then done again."
        ) from None
