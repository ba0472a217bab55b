"""The path in space fits into its picture, whatever its shape."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from studio.app.compare_map import _path_figure
from studio.work.arrays import write_arrays
from studio.work.results import Rows


@pytest.mark.parametrize("sides", [(1.0, 1.0, 1.0), (12.0, 12.0, 0.5), (0.2, 9.0, 0.1), (0.0, 0.0, 30.0)])
def test_no_side_of_a_paths_box_is_longer_than_the_camera_is_placed_for(
    tmp_path: Path, sides: tuple[float, float, float]
) -> None:
    """Plotly's own scale makes the product of the sides 1, and thereby the long side of a flat path 5."""
    rows = 200
    position = np.random.default_rng(0).uniform(size=(rows, 3)) * sides
    position[0] = np.nan
    write_arrays(tmp_path, {"position": position, "time": np.arange(float(rows)), "residual": np.ones((rows, 12))})
    scene = _path_figure(tmp_path, Rows((), 100.0, [0.5] * 12, ()), "light").layout.scene
    ratios = np.array([scene.aspectratio[axis] for axis in "xyz"])
    assert scene.aspectmode == "manual"
    assert ratios.max() == 1.0
    extent = np.ptp(position[1:], axis=0) / np.ptp(position[1:], axis=0).max()
    np.testing.assert_allclose(ratios, np.maximum(extent, 0.05))
