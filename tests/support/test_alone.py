"""Among the workers of one run a test against the clock has the machine to itself."""

from __future__ import annotations

import ast
import subprocess
import sys
from contextlib import closing
from itertools import product
from pathlib import Path

import pytest

from tests.support.alone import MachineLock, runs_alone

pytest_plugins = ("pytester",)
ROOT = Path(__file__).parents[2]

HOLD = """
import sys, time
from pathlib import Path
from tests.support.alone import MachineLock
lock = MachineLock(Path(sys.argv[1]))
lock.acquire(exclusive=sys.argv[2] == "exclusive")
print(time.monotonic(), flush=True)
sys.stdin.readline()
print(time.monotonic(), flush=True)
lock.release()
"""

TESTS = """
import pytest, time
{mark}
@pytest.mark.parametrize("number", range(3))
def test_takes_time(number):
    began = time.monotonic()
    time.sleep(0.2)
    with open({times!r}, "a") as file:
        print([{mark!r} != "", began, time.monotonic()], file=file)
"""


def holder(path: Path, kind: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-c", HOLD, str(path), kind]
    return subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1)


def taken(process: subprocess.Popen[str]) -> float:
    assert process.stdout is not None
    return float(process.stdout.readline())


def given_back(process: subprocess.Popen[str]) -> float:
    out, _ = process.communicate("\n", timeout=20)
    return float(out)


def test_many_share_it_and_one_waits_for_them(tmp_path: Path) -> None:
    first, second = (holder(tmp_path / "lock", "shared") for _ in range(2))
    assert taken(first) > 0
    assert taken(second) > 0
    alone = holder(tmp_path / "lock", "exclusive")
    ended = max(given_back(first), given_back(second))
    assert taken(alone) >= ended
    given_back(alone)


def test_a_lock_of_its_own_is_free(tmp_path: Path) -> None:
    with closing(MachineLock(tmp_path / "first")) as first, closing(MachineLock(tmp_path / "second")) as second:
        first.acquire(exclusive=True)
        second.acquire(exclusive=True)


def test_workers_leave_the_machine_to_tests_against_the_clock(
    pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    times = pytester.path / "times"
    pytester.makeconftest('pytest_plugins = ("tests.support.alone",)')
    pytester.makeini("[pytest]\nmarkers = realtime: against the clock\naddopts = -p no:dash")
    for name, mark in (("a", "@pytest.mark.realtime"), ("b", ""), ("c", "")):
        pytester.makepyfile(**{f"test_{name}": TESTS.format(mark=mark, times=str(times))})
    result = pytester.runpytest_subprocess("-n", "2", "--dist", "loadfile")
    result.assert_outcomes(passed=9)
    flown = [ast.literal_eval(line) for line in times.read_text().splitlines()]
    alone = [(began, ended) for realtime, began, ended in flown if realtime]
    others = [(began, ended) for realtime, began, ended in flown if not realtime]
    assert len(alone) == 3
    assert not [both for both in product(alone, others) if overlap(*both)]


def test_files_with_tests_against_the_clock_come_last(pytester: pytest.Pytester) -> None:
    pytester.makeconftest('pytest_plugins = ("tests.support.alone",)')
    pytester.makeini(f"[pytest]\npythonpath = {ROOT}\nmarkers = realtime: against the clock\naddopts = -p no:dash")
    flown, other = "import pytest\ndef test_0(): ...\n@pytest.mark.realtime\ndef test_1(): ...", "def test_2(): ..."
    pytester.makepyfile(test_a=flown, test_b=other, test_c=other)
    result = pytester.runpytest_subprocess("--collect-only", "-q")
    shown = [line.split(".py")[0] for line in result.outlines if "::" in line]
    assert shown == ["test_b", "test_c", "test_a", "test_a"]


def test_a_test_that_only_repeats_itself_is_not_alone(pytester: pytest.Pytester) -> None:
    marks = ("@pytest.mark.realtime", "@pytest.mark.realtime(alone=False)", "")
    pytester.makeini("[pytest]\nmarkers = realtime: against the clock\naddopts = -p no:dash")
    source = "\n".join(f"{mark}\ndef test_{number}(): ..." for number, mark in enumerate(marks))
    items = pytester.getitems(f"import pytest\n{source}")
    assert [runs_alone(item) for item in items] == [True, False, False]


def overlap(one: tuple[float, float], other: tuple[float, float]) -> bool:
    return one[0] < other[1] and other[0] < one[1]
