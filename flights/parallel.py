"""The parallel map of campaigns, sweeps and studies: in this process, in local processes, or on a Dask cluster.

Results come as they are finished; what a function returns must not depend on which process ran it.
"""

from __future__ import annotations

import multiprocessing
import os
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from typing import Any, TypeVar

from dynamics.errors import RequestError, VehicleError

Item = TypeVar("Item")
Result = TypeVar("Result")


def parallel_map(
    function: Callable[[Item], Result], items: Sequence[Item], *, jobs: int | None = None, scheduler: str | None = None
) -> Iterator[tuple[int, Result]]:
    """(index of the item, result) pairs in the order in which they are finished.

    function: importable by name; items and results are pickled.
    jobs: processes, None for one a core; 1 runs everything in this process.
    scheduler: address of a Dask scheduler (tcp://host:port) that runs them instead.

    An exception of the function is raised here, and no further item is started. Raises RequestError for jobs below 1 or
    a scheduler that cannot be reached, VehicleError when a process was killed.
    """
    if scheduler is not None:
        return _on_cluster(function, items, scheduler)
    count = jobs if jobs is not None else len(os.sched_getaffinity(0))
    if count < 1:
        raise RequestError(f"{count} jobs: wanted 1 or more.")
    if count == 1 or len(items) <= 1:
        return ((index, function(item)) for index, item in enumerate(items))
    return _in_processes(function, items, min(count, len(items)))


def _in_processes(
    function: Callable[[Item], Result], items: Sequence[Item], count: int
) -> Iterator[tuple[int, Result]]:
    # spawned rather than forked: a fork copies threads' locks, and a solver's or a progress bar's thread may hold one
    pool = ProcessPoolExecutor(count, mp_context=multiprocessing.get_context("spawn"), initializer=end_with_parent)
    try:
        places = {pool.submit(function, item): index for index, item in enumerate(items)}
        for done in as_completed(places):
            yield places[done], _local_result(done)
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def end_with_parent() -> None:
    """End this process with its parent: it would otherwise still write files that a resumed run takes over."""
    parent = multiprocessing.parent_process()
    assert parent is not None

    def wait() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=wait, name="end with parent", daemon=True).start()


def _local_result(done: Future[Result]) -> Result:
    try:
        return done.result()
    except BrokenProcessPool as error:
        raise VehicleError(
            "a working process ended by itself, killed or out of memory. Run the same command again with fewer --jobs; "
            "what was finished is kept."
        ) from error


def _cluster_result(done: Any, killed: type[Exception]) -> Any:
    try:
        return done.result()
    except killed as error:
        raise VehicleError(
            f"workers of the cluster ended by themselves, again and again on the same item: {error}. Look at their "
            "logs; run the same command again, what was finished is kept."
        ) from error


def _on_cluster(
    function: Callable[[Item], Result], items: Sequence[Item], address: str
) -> Iterator[tuple[int, Result]]:
    try:
        from dask import distributed  # the flight computer has none
    except ImportError as error:
        raise RequestError(
            "--scheduler needs Dask: pip install 'alula[workbench]', or leave the option out."
        ) from error
    try:
        client = distributed.Client(address, timeout=5, set_as_default=False)
    except (OSError, ValueError) as error:
        raise RequestError(
            f"no Dask scheduler answers at {address}: {error}. Start `dask scheduler` and `dask worker`."
        ) from error
    with client:
        places = {client.submit(function, item, pure=False): index for index, item in enumerate(items)}
        for done in distributed.as_completed(list(places), loop=client.loop):
            yield places[done], _cluster_result(done, distributed.KilledWorker)
