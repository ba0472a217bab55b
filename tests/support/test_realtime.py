"""A marked test repeats itself when the host starved it, and only then; it never passes or fails by repeating alone."""

from __future__ import annotations

import ast
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator

import pytest

from simulation.starvation import Accounts, StarvationMeter, Window, read_accounts, starvation_of
from tests.support.realtime import MAX_ATTEMPTS

pytest_plugins = ("pytester",)

CONFTEST = """
from tests.support.realtime import RealtimePlugin
from simulation.starvation import Starvation

class ScriptedMeter:
    starved = iter({starved})
    is_running = False
    def start(self): pass
    def stop(self): pass
    def since(self, start):
        return Starvation(lost=0.5, longest=0.21, others=3.0, duration=2.0) if next(self.starved) else Starvation()

def pytest_configure(config):
    config.addinivalue_line("markers", "realtime: ...")
    config.pluginmanager.register(RealtimePlugin(ScriptedMeter(), quiet_patience=0.0))
"""

FLAKY = """
import os, pytest
attempts = []

@pytest.fixture(scope="module")
def vehicle():
    attempts.append("new vehicle")
    yield
    attempts.append("vehicle away")

@pytest.mark.realtime
def test_flight(vehicle):
    attempts.append(os.getpriority(os.PRIO_PROCESS, 0))
    assert len([a for a in attempts if isinstance(a, int)]) > FAILURES, "fell from the sky"

def test_what_happened():
    print("HAPPENED", attempts)
"""

Run = Callable[..., pytest.RunResult]


@pytest.fixture
def run(pytester: pytest.Pytester) -> Run:
    """Run the flaky flight. failures: how often it fails. starved: what the meter shows, attempt by attempt."""

    def run(failures: int, starved: list[bool]) -> pytest.RunResult:
        pytester.makeconftest(CONFTEST.format(starved=starved))
        pytester.makepyfile(FLAKY.replace("FAILURES", str(failures)))
        return pytester.runpytest_inprocess("-s", "-p", "no:cacheprovider")

    return run


def test_a_starved_failure_is_repeated_with_fresh_fixtures_and_higher_priority(run: Run) -> None:
    result = run(1, [True, False])
    result.assert_outcomes(passed=2)
    before = os.getpriority(os.PRIO_PROCESS, 0)
    (line,) = [line for line in result.outlines if "HAPPENED" in line]
    story = ast.literal_eval(line.split("HAPPENED")[1].strip())
    assert [step for step in story if isinstance(step, str)] == ["new vehicle", "vehicle away", "new vehicle"]
    first, second = (step for step in story if isinstance(step, int))
    assert first == before
    assert second <= before
    result.stdout.fnmatch_lines(["*repeated because the machine was busy*", "*test_flight (attempt 2)*3.0 of*"])


def test_a_failure_without_starvation_counts_at_once(run: Run) -> None:
    result = run(1, [False])
    result.assert_outcomes(passed=1, failed=1)
    assert "HAPPENED ['new vehicle'" in result.stdout.str()
    assert "machine was" not in result.stdout.str()


def test_a_real_failure_in_a_repetition_counts(run: Run) -> None:
    result = run(MAX_ATTEMPTS, [True, False])
    result.assert_outcomes(passed=1, failed=1)
    assert "too busy" not in result.stdout.str()


def test_a_failure_in_every_starved_attempt_counts_with_what_was_measured(run: Run) -> None:
    result = run(MAX_ATTEMPTS, [True] * MAX_ATTEMPTS)
    result.assert_outcomes(passed=1, failed=1)
    result.stdout.fnmatch_lines(["*fell from the sky*", "*too busy in each of 4 attempts*0.50 s*210 ms*3.0 of*"])


def test_a_starved_test_that_passes_is_not_repeated(run: Run) -> None:
    result = run(0, [True, True])
    result.assert_outcomes(passed=2)
    assert "machine was busy" not in result.stdout.str()


def test_a_teardown_that_fails_for_starvation_repeats_the_test(pytester: pytest.Pytester) -> None:
    pytester.makeconftest(CONFTEST.format(starved=[True, True, False]))
    pytester.makepyfile(
        """
        import pytest
        times = []

        @pytest.fixture
        def vehicle():
            yield
            times.append(1)
            assert len(times) > 1

        @pytest.mark.realtime
        def test_flight(vehicle):
            pass
        """
    )
    pytester.runpytest_inprocess("-p", "no:cacheprovider").assert_outcomes(passed=1)


def window(wait: float, others: float, stolen: float = 0.0) -> Window:
    return Window(start=0.0, end=0.2, wait=wait, others=others, stolen=stolen)


def test_waiting_counts_only_beside_other_programs_or_under_a_hypervisor_that_steals() -> None:
    assert window(wait=0.1, others=1.0).lost == 0.1
    assert window(wait=0.1, others=0.1).lost == 0.0  # our own threads in each other's way
    assert window(wait=0.001, others=2.0).lost == 0.0
    assert window(wait=0.0, others=0.0, stolen=0.1).lost == 0.1


def test_the_sum_of_windows_names_the_worst() -> None:
    sum_of = starvation_of([window(0.05, 1.0), window(0.15, 2.0), window(0.1, 0.0)])
    assert sum_of.is_starved
    assert (sum_of.lost, sum_of.longest, sum_of.others) == pytest.approx((0.2, 0.15, 2.0))
    assert not starvation_of([]).is_starved


def test_others_are_what_ran_and_was_not_ours() -> None:
    before = Accounts(time=1.0, threads={1: (5.0, 1.0)}, busy=100.0, stolen=0.0)
    after = Accounts(time=2.0, threads={1: (5.3, 1.2), 2: (0.2, 0.4)}, busy=101.6, stolen=0.1)
    between = after.since(before)
    assert (between.wait, between.others, between.stolen) == pytest.approx((0.4, 1.1, 0.1))


@pytest.fixture
def busy() -> Iterator[subprocess.Popen[bytes]]:
    """A child that computes."""
    with subprocess.Popen([sys.executable, "-c", "while True: pass"]) as child:
        yield child
        child.kill()


def test_the_accounts_hold_this_process_and_its_children(busy: subprocess.Popen[bytes]) -> None:
    deadline = time.monotonic() + 20.0
    while read_accounts().threads.get(busy.pid, (0.0, 0.0))[0] < 0.1:
        assert time.monotonic() < deadline
    assert os.getpid() in read_accounts().threads


def test_the_meter_sees_that_strangers_keep_us_waiting() -> None:
    hogs = [
        # not our descendants: the shell that starts them ends at once
        subprocess.run(
            ["sh", "-c", f"timeout 20 {sys.executable} -c 'while True: pass' >/dev/null 2>&1 & echo $!"],
            stdout=subprocess.PIPE,
            check=True,
        )
        for _ in range(2 * (os.cpu_count() or 1))
    ]
    meter = StarvationMeter()
    start = time.monotonic()
    meter.start()
    try:
        while not meter.since(start).is_starved:
            assert time.monotonic() < start + 20.0
    finally:
        meter.stop()
        for hog in hogs:
            os.kill(int(hog.stdout), signal.SIGTERM)
    assert "other programs took up to" in str(meter.since(start))
