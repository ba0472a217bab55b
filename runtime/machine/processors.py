"""Clock rate, throttling, and the clock that everything is timed by."""

from __future__ import annotations

import itertools
import time
from collections import Counter
from pathlib import PurePosixPath

from runtime.machine.check import Check, State, SystemFiles

GOVERNOR, THROTTLING, CLOCK = "clock rate", "throttling", "clock source"
CPU = "sys/devices/system/cpu"
RASPBERRY_PI = "sys/devices/platform/soc/soc:firmware/get_throttled"
PI_NOW, PI_SINCE_BOOT = 0xF, 0xF0000  # bits of under-voltage, capped clock, throttling, soft temperature limit
SLOW_SOURCES = ("hpet", "acpi_pm", "jiffies", "refined-jiffies", "pit")  # read over a bus, or by ticks of the kernel
READS = 20_000  # of the clock
MAX_STEP = 1e-5  # s; a hundredth of the link's round trip, by which an estimate's age is known
MAX_USABLE_STEP = 1e-3  # s; ages of estimates are then no better than the autopilot's own delay


def check_governor(files: SystemFiles) -> Check:
    """Whether the processors' clock rate is constant, by the governors of cpufreq."""
    governors = Counter(files.texts(f"{CPU}/cpu[0-9]*/cpufreq/scaling_governor"))
    if not governors:
        return Check(GOVERNOR, "ok", "set outside of this system: by firmware, or a virtual machine's host")
    measured = ", ".join(f"governor {name} on {count}" for name, count in governors.items())
    if set(governors) == {"performance"}:
        return Check(GOVERNOR, "ok", measured)
    advice = f"echo performance | sudo tee /{CPU}/cpu*/cpufreq/scaling_governor; Jetson: sudo jetson_clocks"
    return Check(GOVERNOR, "warning", f"{measured}: a tick may begin at a low rate", advice)


def check_throttling(files: SystemFiles) -> Check:
    """Whether heat, supply voltage or a quota has held the processors back since they started."""
    held_back, now = [], False
    if count := sum(int(text) for text in files.texts(f"{CPU}/cpu[0-9]*/thermal_throttle/core_throttle_count")):
        held_back.append(f"throttled by heat {count}x since the start")
    if flags := int(files.text(RASPBERRY_PI) or "0", 16):
        now = bool(flags & PI_NOW)
        held_back.append(f"get_throttled is {flags:#x}: {'now' if now else 'since the start'}")
    advice = "cool it, and give it a supply of its own; look again after some minutes of load" if held_back else ""
    if (share := _quota(files)) is not None:
        held_back.append(f"a quota of {share:g} processors (cpu.max)")
        quota = (
            "raise the container's or service's CPU quota: once it is used up, no tick runs until its period is over"
        )
        advice = "; ".join(filter(None, (advice, quota)))
    if not held_back:
        return Check(THROTTLING, "ok", "none counted")
    return Check(THROTTLING, "warning", "; ".join(held_back), advice)


def _quota(files: SystemFiles) -> float | None:
    """The smallest CPU quota of this process' control groups (cgroup v2), processors; None without one."""
    own = next((line[3:] for line in files.text("proc/self/cgroup").splitlines() if line.startswith("0::")), "/")
    group = PurePosixPath(own.lstrip("/"))
    shares = []
    for each in (group, *group.parents):
        quota, _, period = files.text(f"sys/fs/cgroup/{each}/cpu.max").partition(" ")
        if quota.isdigit() and period.isdigit():
            shares.append(int(quota) / int(period))
    return min(shares, default=None)


def check_clock(files: SystemFiles) -> Check:
    """The kernel's clock source, and the step and cost of reading the monotonic clock."""
    source = files.text("sys/devices/system/clocksource/clocksource0/current_clocksource") or "unknown"
    step, cost = clock_step()
    measured = f"{source}, steps of {1e6 * step:.2g} us, {1e9 * cost:.0f} ns a reading"
    slow = source in SLOW_SOURCES or step > MAX_STEP
    state: State = "problem" if step > MAX_USABLE_STEP else "warning" if slow else "ok"
    available = files.text("sys/devices/system/clocksource/clocksource0/available_clocksource") or "unknown"
    advice = f"choose another clock source: clocksource=NAME on the kernel's command line, of {available}"
    return Check(CLOCK, state, measured, "" if state == "ok" else advice)


def clock_step() -> tuple[float, float]:
    """Smallest step of the monotonic clock, and the time of one reading, s."""
    times = [time.monotonic_ns() for _ in range(READS)]
    steps = [after - before for before, after in itertools.pairwise(times) if after > before]
    while not steps:  # a step is longer than all the readings
        after = time.monotonic_ns()
        if after > times[-1]:
            steps.append(after - times[-1])
    return 1e-9 * min(steps), 1e-9 * (times[-1] - times[0]) / len(times)
