"""One function over many items gives the same results in this process, in others and on a Dask cluster."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import psutil
import pytest

from dynamics.errors import DataError, RequestError, VehicleError
from dynamics.trust import approve_here, approved_here
from flights.parallel import parallel_map


def square(number: int) -> int:
    return number * number


def refuse(number: int) -> int:
    raise DataError(f"{number} is no good")


def die(number: int) -> int:
    os.kill(os.getpid(), signal.SIGKILL)
    return number


@pytest.mark.parametrize("jobs", [1, 2])
def test_every_item_has_its_result(jobs: int) -> None:
    assert sorted(parallel_map(square, range(5), jobs=jobs)) == [(i, i * i) for i in range(5)]


@pytest.mark.parametrize("jobs", [1, 2])
def test_what_the_function_raises_is_raised(jobs: int) -> None:
    with pytest.raises(DataError, match="is no good"):
        list(parallel_map(refuse, [1, 2], jobs=jobs))


def test_a_killed_process_is_named() -> None:
    with pytest.raises(VehicleError, match="a worker process died"):
        list(parallel_map(die, [1, 2], jobs=2))


SCRIPT = """
import operator
from dynamics.trust import approve_here, approved_here
from flights.parallel import parallel_map
print(list(parallel_map(operator.neg, [1, 2], jobs=2{killed})))
"""


@pytest.mark.parametrize("killed", ["", ", killed=operator.pos"])
def test_a_script_whose_import_starts_processes_is_named(tmp_path: Path, killed: str) -> None:
    script = tmp_path / "script.py"
    script.write_text(SCRIPT.format(killed=killed))
    ran = subprocess.run([sys.executable, str(script)], check=False, capture_output=True, text=True, timeout=120)
    assert (ran.returncode, ran.stdout) == (1, "")
    messages = [line for line in ran.stderr.splitlines() if line.startswith("dynamics.errors.RequestError:")]
    assert messages, ran.stderr  # on a busy machine a warning of Python's own resource tracker may follow it
    assert 'if __name__ == "__main__":' in messages[-1]


def die_on_two(number: int) -> int:
    return die(number) if number == 2 else number * number


def test_an_item_that_kills_its_process_twice_has_the_result_for_that_and_the_others_continue() -> None:
    results = dict(parallel_map(die_on_two, range(5), jobs=2, killed=lambda number: -number))
    assert results == {0: 0, 1: 1, 2: -2, 3: 9, 4: 16}


def die_first(path: Path) -> str:
    if path.exists():
        return "done"
    path.touch()
    os.kill(os.getpid(), signal.SIGKILL)
    return "never"


def test_an_item_whose_process_is_killed_once_is_done_again(tmp_path: Path) -> None:
    results = dict(parallel_map(die_first, [tmp_path / "mark"], jobs=1, killed=lambda _: "killed"))
    assert results == {0: "done"}


ORPHANS = """
import os, sys, time
from pathlib import Path
from dynamics.trust import approve_here, approved_here
from flights.parallel import parallel_map

def work(folder):
    Path(folder, str(os.getpid())).touch()
    time.sleep(600)

if __name__ == "__main__":
    list(parallel_map(work, [sys.argv[1]] * 2, jobs=2))
"""


def test_processes_end_with_the_one_that_started_them(tmp_path: Path) -> None:
    """A training that was killed is resumed at once, and nobody else may write its files."""
    script, folder = tmp_path / "orphans.py", tmp_path / "started"
    script.write_text(ORPHANS)
    folder.mkdir()
    deadline = time.monotonic() + 250
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])}
    with subprocess.Popen([sys.executable, str(script), str(folder)], env=environment) as parent:
        while len(list(folder.iterdir())) < 2:
            assert time.monotonic() < deadline
            time.sleep(0.05)
        parent.kill()
    workers = [Path("/proc", file.name, "cmdline") for file in folder.iterdir()]
    while any(worker.exists() and worker.read_bytes() for worker in workers):  # empty once it has ended
        assert time.monotonic() < deadline
        time.sleep(0.05)


def test_no_jobs_at_all_are_refused() -> None:
    with pytest.raises(RequestError, match="0 jobs"):
        list(parallel_map(square, [1], jobs=0))


def test_a_scheduler_that_does_not_answer_is_named() -> None:
    with pytest.raises(RequestError, match="no Dask scheduler answers"):
        list(parallel_map(square, [1], scheduler="tcp://127.0.0.1:9"))


def test_a_dask_cluster_does_the_same() -> None:
    distributed = pytest.importorskip("dask.distributed")
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, dashboard_address="127.0.0.1:0", protocol="tcp"
    ) as cluster:
        assert sorted(parallel_map(square, [1, 2, 3], scheduler=cluster.scheduler_address)) == [(0, 1), (1, 4), (2, 9)]


def approved_of(_: int) -> tuple[tuple[str, str], ...]:
    """What is approved in the process that works."""
    return approved_here()


def test_processes_have_the_approvals_of_the_call(nothing_approved: Path) -> None:
    approve_here([("effects", "a" * 64)])
    assert [result for _, result in parallel_map(approved_of, [0, 1], jobs=2)] == [(("effects", "a" * 64),)] * 2


WAITING = """
import sys, time
from flights.parallel import parallel_map

def wait(item):
    print("begun", flush=True)
    time.sleep(item)
    return item

if __name__ == "__main__":
    list(parallel_map(wait, [WORK] * 4, jobs=2))
"""
WORK = 240.0  # s


@contextmanager
def script_of(text: str, first_line: str, folder: Path) -> Iterator[subprocess.Popen[str]]:
    """A script that runs in a process group of its own and has printed its first line."""
    script = folder / "script.py"
    script.write_text(text)
    environment = {**os.environ, "PYTHONPATH": str(Path.cwd())}
    with subprocess.Popen(
        [sys.executable, script],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment, start_new_session=True,
    ) as process:  # fmt: skip
        assert process.stdout is not None
        assert process.stdout.readline() == f"{first_line}\n"
        yield process


@pytest.mark.parametrize("whole_group", [False, True])
def test_an_interrupt_does_not_wait_for_running_items(whole_group: bool, tmp_path: Path) -> None:
    """A terminal interrupts all processes, `kill -INT` the first one alone."""
    with script_of(WAITING.replace("WORK", str(WORK)), "begun", tmp_path) as process:
        (os.killpg if whole_group else os.kill)(process.pid, signal.SIGINT)
        began = time.monotonic()
        _, wrong = process.communicate(timeout=WORK)
        assert time.monotonic() - began < 0.2 * WORK
    assert process.returncode != 0
    assert wrong.count("Traceback") <= 1, wrong  # the script's own, none of a working process


STARTING = """
import time
from contextlib import suppress

def start():
    HOW

if __name__ == "__main__":
    with suppress(KeyboardInterrupt):
        print("starting", flush=True)
        start()
"""
IN_A_POOL = "from flights.parallel import parallel_map\n    list(parallel_map(time.sleep, [240.0] * 4, jobs=2))"
BESIDE_A_TRAINING = """from training.reports import progress_channel
    with progress_channel(print):
        time.sleep(240.0)"""
BEHIND_THE_STUDIO = """from studio.work.worker import Worker
    Worker(memory=2**32)
    time.sleep(240.0)"""


@pytest.mark.parametrize("how", [IN_A_POOL, BESIDE_A_TRAINING, BEHIND_THE_STUDIO], ids=["pool", "training", "studio"])
@pytest.mark.parametrize("after", [0.1, 0.4, 0.8])
def test_a_process_that_is_starting_prints_no_traceback_of_an_interrupt(how: str, after: float, tmp_path: Path) -> None:
    with script_of(STARTING.replace("HOW", how), "starting", tmp_path) as process:
        while not any("spawn_main" in " ".join(child.cmdline()) for child in psutil.Process(process.pid).children()):
            time.sleep(0.01)
        time.sleep(after)  # while it imports
        os.killpg(process.pid, signal.SIGINT)
        _, wrong = process.communicate(timeout=120)
    assert "Traceback" not in wrong
