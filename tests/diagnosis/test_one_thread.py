"""Numerical libraries during a diagnosis that is called from Python."""

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from diagnosis.one_thread import one_thread


def threads() -> set[int]:
    return {library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"}


@pytest.fixture(autouse=True)
def two_threads():
    np.linalg.inv(np.eye(2))  # loads the library
    with threadpool_limits(2):
        yield


def test_libraries_use_one_thread_inside_and_as_many_as_before_after():
    assert one_thread(threads)() == {1}
    assert threads() == {2}


def test_an_error_gives_the_threads_back():
    @one_thread
    def failing() -> None:
        raise ValueError("no")

    with pytest.raises(ValueError, match="no"):
        failing()
    assert threads() == {2}
