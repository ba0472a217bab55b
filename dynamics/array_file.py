"""NumPy's files of arrays (.npz) of unknown origin, with one kind of error whatever is wrong with one."""

from __future__ import annotations

import struct
import tokenize
import zipfile
import zlib
from pathlib import Path

import numpy as np

from dynamics.arrays import Floats
from dynamics.errors import RequestError
from dynamics.unpacking import Unpacking

# Of zipfile, and of NumPy's parser of headers, which tokenizes Python; a size that no memory holds is damage as well.
DAMAGE = (
    OSError, EOFError, ValueError, LookupError, TypeError, RuntimeError, OverflowError, MemoryError, SyntaxError,
    struct.error, tokenize.TokenError, zipfile.BadZipFile, zlib.error,
)  # fmt: skip


def read_arrays(path: Path, *, advice: str) -> dict[str, Floats]:
    """The arrays of a file by name. advice: what to do about one that is damaged.

    Raises RequestError for a file that cannot be read, or holds anything but numbers.
    """
    try:
        with path.open("rb") as file, np.load(file) as content:  # which would leave a damaged one open
            unpacking = Unpacking(path, path.stat().st_size)
            for member in content.zip.infolist():  # zipfile unpacks no more than it declares
                unpacking.add_file()
                unpacking.add_bytes(member.file_size, unpacking.size)
            arrays = {name: np.asarray(content[name]) for name in content.files}
            if wrong := [name for name, array in arrays.items() if array.dtype.kind not in "biuf"]:
                raise ValueError(f"{wrong[0]} holds no numbers")
            return arrays
    except DAMAGE as error:
        raise RequestError(f"cannot read {path}: {error or type(error).__name__}. {advice}") from None
