"""The kernels' C under the address and undefined-behaviour sanitizers, with numbers that no flight has among others."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from dynamics.vehicle import EffectUse
from tests.fuzz import sanitized
from tests.fuzz.sanitized import LAG_AND_DRAG, network_program, solver_program

WIND = EffectUse("wind", {"x": 1.0})
Made = Callable[[Path], tuple[Path, bytes]]
PROGRAMS: dict[str, Made] = {
    "solver": solver_program,
    "network": lambda folder: network_program(folder, precision="float", residual=False),
}
LARGER: dict[str, Made] = {  # which take longer to compile: in make fuzz
    "solver that follows": lambda folder: solver_program(folder, *LAG_AND_DRAG, WIND, follow=["rotor_drag", "wind"]),
    "residual network": lambda folder: network_program(folder, precision="double", residual=True),
}
CALLS = 2000


@pytest.mark.parametrize("name", list(PROGRAMS))
def test_no_call_touches_foreign_memory_or_is_undefined(name: str, tmp_path: Path) -> None:
    if reason := sanitized.why_not():
        pytest.skip(reason)
    program, content = PROGRAMS[name](tmp_path)
    for seed in range(2):
        done = sanitized.run(program, content, seed, CALLS)
        assert done.returncode == 0, f"seed {seed}: {done.stderr.decode()[-3000:]}"
        assert done.stdout.decode() == f"{CALLS} calls\n"


def test_the_sanitizers_see_a_fault(tmp_path: Path) -> None:
    """A write behind the end of a row, which is still inside of the array."""
    if reason := sanitized.why_not():
        pytest.skip(reason)
    (tmp_path / "box.c").write_text("double rows[4][1];\nint main(int n, char **w) { rows[0][n] = 1; return 0; }\n")
    program = sanitized.compiled(tmp_path, "box.c", (), ())
    done = sanitized.run(program, b"", 0, 0)
    assert done.returncode != 0
    assert b"out of bounds" in done.stderr
