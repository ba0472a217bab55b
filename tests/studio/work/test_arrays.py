"""Tables of a result: what is damaged is named, with what to do."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from dynamics.errors import RequestError
from studio.work.arrays import read_array, write_arrays


def test_a_table_comes_back_as_it_was_written(tmp_path: Path) -> None:
    write_arrays(tmp_path, {"time": np.arange(5.0)})
    np.testing.assert_array_equal(read_array(tmp_path, "time"), np.arange(5.0))
    with pytest.raises(FileNotFoundError):
        read_array(tmp_path, "none")


@pytest.mark.parametrize("damage", ["cut", "empty", "header", "text", "objects"])
def test_a_damaged_table_is_named_with_what_to_do(tmp_path: Path, damage: str) -> None:
    write_arrays(tmp_path, {"time": np.arange(500.0)})
    path = tmp_path / "time.npy"
    content = path.read_bytes()
    damaged = {
        "cut": content[: len(content) // 2], "empty": b"", "text": b"no array",
        "header": content[:20] + b"\x00\xff{(" + content[24:],
    }  # fmt: skip
    if damage == "objects":
        np.save(path, np.array([{}, []], dtype=object), allow_pickle=True)
    else:
        path.write_bytes(damaged[damage])
    with pytest.raises(RequestError, match=r"time\.npy is damaged: .+ Delete the folder .+ done again"):
        read_array(tmp_path, "time")
