"""The parallel map of campaigns, sweeps and studies: in this process, in local processes, or on a Dask cluster.

Results come as they are finished; what a function returns must not depend on which process ran it.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import resource_tracker
from multiprocessing.synchronize import Event
from typing import Any, TypeVar

from dynamics.approvals import Kind
from dynamics.errors import RequestError, VehicleError
from dynamics.recorded_vehicle import choose_system, chosen_system
from dynamics.trust import approve_here, approved_here
from dynamics.workbench_install import workbench_install

Item = TypeVar("Item")
Result = TypeVar("Result")
Approved = tuple[tuple[Kind, str], ...]


def parallel_map(
    function: Callable[[Item], Result],
    items: Sequence[Item],
    *,
    jobs: int | None = None,
    scheduler: str | None = None,
    killed: Callable[[Item], Result] | None = None,
) -> Iterator[tuple[int, Result]]:
    """(index of the item, result) pairs in the order in which they are finished.

    function: importable by name; items and results are pickled.
    jobs: processes, None for one a core; 1 runs everything in this process.
    scheduler: address of a Dask scheduler (tcp://host:port) that runs them instead.
    killed: the result of an item whose process was killed twice, the second time with no other item beside it. With it
        everything runs in other processes, and the other items continue; without it such an item ends the map.

    An exception of the function is raised here, and no further item is started. Raises RequestError for jobs below 1, a
    scheduler that cannot be reached and a script whose import starts processes, VehicleError when a process was killed
    or the scheduler went away.
    """
    if scheduler is not None:
        return _on_cluster(function, items, scheduler, killed)
    count = jobs if jobs is not None else len(os.sched_getaffinity(0))
    if count < 1:
        raise RequestError(f"{count} jobs: wanted 1 or more.")
    if killed is None and (count == 1 or len(items) <= 1):
        return ((index, function(item)) for index, item in enumerate(items))
    return _in_processes(function, items, min(count, len(items)), killed)


def _in_processes(
    function: Callable[[Item], Result], items: Sequence[Item], count: int, killed: Callable[[Item], Result] | None
) -> Iterator[tuple[int, Result]]:
    waiting = deque(range(len(items)))
    while waiting:
        for place in (yield from _in_pool(function, items, waiting, count)):
            if killed is None:
                raise VehicleError(
                    "a worker process died, killed or out of memory. Run the same command again with fewer "
                    "--jobs; what was finished is kept."
                )
            if (yield from _in_pool(function, items, deque([place]), 1)):
                yield place, killed(items[place])


def _in_pool(
    function: Callable[[Item], Result], items: Sequence[Item], waiting: deque[int], count: int
) -> Generator[tuple[int, Result], None, list[int]]:
    """Results of waiting items, which are removed. Returns those that were running when a process was killed."""
    # spawned rather than forked: a fork copies threads' locks, and a solver's or a progress bar's thread may hold one
    context = multiprocessing.get_context("spawn")
    started = context.Event()
    others = set(multiprocessing.active_children())
    initial = (started, approved_here(), chosen_system())
    pool = ProcessPoolExecutor(count, mp_context=context, initializer=_begin, initargs=initial)
    running: dict[Future[Result], int] = {}
    try:
        while waiting or running:
            while waiting and len(running) < count:  # no more at once, so that few are suspected when one is killed
                place = waiting.popleft()
                try:
                    with holding_interrupts():
                        submitted = pool.submit(function, items[place])
                    running[submitted] = place
                except BrokenProcessPool:
                    _require_started(started)
                    return [*running.values(), place]
            finished, _ = wait(running, return_when=FIRST_COMPLETED)
            for done in sorted(finished, key=running.__getitem__):
                if isinstance(done.exception(), BrokenProcessPool):
                    continue
                yield running.pop(done), done.result()
            if any(done in running for done in finished):
                _require_started(started)
                return list(running.values())
    except (KeyboardInterrupt, GeneratorExit):  # nobody waits for the items that are running
        for process in set(multiprocessing.active_children()) - others:
            process.terminate()
        raise
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
    return []


@contextmanager
def holding_interrupts() -> Iterator[None]:
    """Hold interrupts back, here and in the processes that are started meanwhile: a terminal interrupts them all.

    A process that is starting would print a traceback, and whoever starts it would lose it between start and record.
    The mask goes on to the process; here another thread may still receive the signal, so that it is noted.
    """
    resource_tracker.ensure_running()  # which lets interrupts through when it starts
    handler, noted = signal.getsignal(signal.SIGINT), threading.Event()
    handles = threading.current_thread() is threading.main_thread() and callable(handler)
    if handles:
        signal.signal(signal.SIGINT, lambda *_: noted.set())
    before = signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT,))
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        if handles:
            signal.signal(signal.SIGINT, handler)
    if noted.is_set():
        signal.raise_signal(signal.SIGINT)


def _begin(started: Event, approved: Approved, system: int | None) -> None:
    # a terminal interrupts all processes, and the parent ends these; SIG_IGN would go on to what these start
    signal.signal(signal.SIGINT, lambda *_: None)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, (signal.SIGINT,))
    started.set()
    approve_here(approved)
    choose_system(system)
    end_with_parent()


def _require_started(started: Event) -> None:
    if not started.is_set():
        raise RequestError(
            "the working processes ended before they began. Each imports the script that was started: put what it does "
            'behind `if __name__ == "__main__":`.'
        )


def end_with_parent() -> None:
    """End this process with its parent: it would otherwise still write files that a resumed run takes over."""
    parent = multiprocessing.parent_process()
    assert parent is not None

    def wait() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=wait, name="end with parent", daemon=True).start()


def _on_cluster(
    function: Callable[[Item], Result], items: Sequence[Item], address: str, killed: Callable[[Item], Result] | None
) -> Iterator[tuple[int, Result]]:
    try:
        from dask import distributed  # the flight computer has none
    except ImportError as error:
        raise RequestError(f"--scheduler needs Dask: {workbench_install()}, or leave the option out.") from error
    try:
        client = distributed.Client(address, timeout=5, set_as_default=False)
    except (OSError, ValueError) as error:
        raise RequestError(
            f"no Dask scheduler answers at {address}: {error}. Start `dask scheduler` and `dask worker`."
        ) from error
    with client:
        places = {
            client.submit(_approving, approved_here(), chosen_system(), function, item, pure=False): index
            for index, item in enumerate(items)
        }
        for done in distributed.as_completed(list(places), loop=client.loop):
            place = places.pop(done)
            try:
                result = _cluster_result(done, distributed.KilledWorker)
            except VehicleError as error:
                if killed is None or not isinstance(error.__cause__, distributed.KilledWorker):
                    raise
                result = killed(items[place])
            done.release()
            yield place, result


def _approving(approved: Approved, system: int | None, function: Callable[[Item], Result], item: Item) -> Result:
    """A function's result where effects are approved and a vehicle is chosen as in the process that asks for it."""
    approve_here(approved)
    choose_system(system)
    return function(item)


def _cluster_result(done: Any, killed: type[Exception]) -> Any:
    try:
        return done.result()
    except killed as error:
        raise VehicleError(
            f"workers of the cluster ended by themselves, again and again on the same item: {error}. Look at their "
            "logs; run the same command again, what was finished is kept."
        ) from error
    except CancelledError as error:
        raise VehicleError(
            "the Dask scheduler went away. Start it and its workers; run the same command again, what was finished is "
            "kept."
        ) from error
