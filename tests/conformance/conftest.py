"""One mock as a process and one client on its companion link, shared by the tests of a file."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from simulation.mock_process import MockProcess, mock_process
from tests.conformance.raw_link import RawLink


@pytest.fixture(scope="module", params=["px4_sih", pytest.param("arpl_250g", marks=pytest.mark.slow)])
def mock(request: pytest.FixtureRequest) -> Iterator[MockProcess]:
    """PX4's SIH quadrotor, and a vehicle of another size; a file's MOCK holds further arguments of `alula mock`."""
    with mock_process(*getattr(request.module, "MOCK", ()), vehicle=request.param) as process:
        yield process


@pytest.fixture(scope="module")
def is_sih(mock: MockProcess) -> bool:
    """Whether the mock is PX4's SIH quadrotor, on which the numbers of its flight were measured."""
    return any("px4_sih" in str(argument) for argument in mock.process.args)  # type: ignore[union-attr]


@pytest.fixture(scope="module")
def link(mock: MockProcess) -> Iterator[RawLink]:
    """A companion that has heard the mock."""
    with RawLink(mock.port) as link:
        yield link
