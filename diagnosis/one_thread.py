"""One thread a library: the matrices here have tens of rows, over which more threads wait for each other.

The command line asks for one before libraries are loaded; who calls a function from Python has loaded them.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar

from threadpoolctl import threadpool_limits

P = ParamSpec("P")
T = TypeVar("T")


def one_thread(function: Callable[P, T]) -> Callable[P, T]:
    """A function during which numerical libraries use one thread each, and as many as before after it."""

    @wraps(function)
    def limited(*arguments: P.args, **named: P.kwargs) -> T:
        with threadpool_limits(limits=1):
            return function(*arguments, **named)

    return limited
