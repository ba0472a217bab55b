"""Checks that read the kernel's files, on computers made of files: each state has its figure and what to do."""

from __future__ import annotations

from pathlib import Path

import pytest

from runtime.machine import processors, scheduling
from runtime.machine.check import SystemFiles

GOVERNOR = "sys/devices/system/cpu/cpu{}/cpufreq/scaling_governor"
HEAT = "sys/devices/system/cpu/cpu{}/thermal_throttle/core_throttle_count"
SOURCE = "sys/devices/system/clocksource/clocksource0/current_clocksource"
AUTOGROUP = "proc/sys/kernel/sched_autogroup_enabled"


def computer(root: Path, files: dict[str, str]) -> SystemFiles:
    for name, text in files.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(f"{text}\n")
    return SystemFiles(root)


def test_a_constant_clock_rate_is_right_and_another_is_not(tmp_path: Path) -> None:
    names = [GOVERNOR.format(number) for number in range(4)]
    check = processors.check_governor(computer(tmp_path, dict.fromkeys(names, "performance")))
    assert (check.state, check.advice) == ("ok", "")
    check = processors.check_governor(computer(tmp_path, {names[3]: "ondemand"}))
    assert check.state == "warning"
    assert "performance on 3, governor ondemand on 1" in check.measured
    assert "scaling_governor" in check.advice


def test_a_computer_without_a_governor_is_no_worse(tmp_path: Path) -> None:
    assert processors.check_governor(SystemFiles(tmp_path)).state == "ok"
    assert processors.check_throttling(SystemFiles(tmp_path)).state == "ok"


@pytest.mark.parametrize(
    ("files", "measured", "advice"),
    [
        ({HEAT.format(0): "0", HEAT.format(1): "7"}, "by heat 7x", "cool it"),
        ({processors.RASPBERRY_PI: "50005"}, "0x50005: now", "supply"),
        ({processors.RASPBERRY_PI: "50000"}, "0x50000: since the start", "supply"),
        ({"proc/self/cgroup": "0::/a/b", "sys/fs/cgroup/a/cpu.max": "50000 100000"}, "0.5 processors", "quota"),
        ({"proc/self/cgroup": "0::/", "sys/fs/cgroup/cpu.max": "150000 100000"}, "1.5 processors", "quota"),
    ],
)
def test_what_holds_the_processors_back_is_named(
    files: dict[str, str], measured: str, advice: str, tmp_path: Path
) -> None:
    check = processors.check_throttling(computer(tmp_path, files))
    assert check.state == "warning"
    assert measured in check.measured
    assert advice in check.advice


@pytest.mark.parametrize(
    "files",
    [
        {HEAT.format(0): "0"},
        {processors.RASPBERRY_PI: "0"},
        {"proc/self/cgroup": "0::/a", "sys/fs/cgroup/a/cpu.max": "max 100000"},
        {"proc/self/cgroup": "0::/a", "sys/fs/cgroup/b/cpu.max": "50000 100000"},  # another's
    ],
)
def test_nothing_that_holds_back_is_ok(files: dict[str, str], tmp_path: Path) -> None:
    assert processors.check_throttling(computer(tmp_path, files)).state == "ok"


@pytest.mark.parametrize(
    ("source", "step", "state"),
    [("tsc", 1e-8, "ok"), ("hpet", 1e-7, "warning"), ("tsc", 1e-4, "warning"), ("jiffies", 4e-3, "problem")],
)
def test_a_clock_is_judged_by_its_source_and_its_step(
    source: str, step: float, state: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(processors, "clock_step", lambda: (step, 1e-7))
    check = processors.check_clock(computer(tmp_path, {SOURCE: source}))
    assert check.state == state
    assert source in check.measured
    assert bool(check.advice) == (state != "ok")


def test_this_computers_clock_has_a_step_and_a_cost() -> None:
    step, cost = processors.clock_step()
    assert 0 < step < 0.1
    assert 0 < cost < 0.1


@pytest.mark.parametrize(
    ("enabled", "permitted", "state"),
    [("1", True, "ok"), ("1", False, "warning"), ("0", False, "ok"), ("", False, "ok")],
)
def test_autogroup_matters_without_real_time_scheduling(
    enabled: str, permitted: bool, state: str, tmp_path: Path
) -> None:
    files = computer(tmp_path, {AUTOGROUP: enabled} if enabled else {})
    assert scheduling.check_autogroup(files, realtime_permitted=permitted).state == state
