"""Real-time scheduling, autogroup and locked memory: tried as a flight would, and put back."""

from __future__ import annotations

import resource
import threading

from runtime import realtime
from runtime.machine.check import Check, SystemFiles

REALTIME, AUTOGROUP, MEMORY = "real-time scheduling", "autogroup", "memory lock"


def check_realtime(priority: int) -> Check:
    """Whether a thread may take SCHED_FIFO. priority: 1 to 99."""
    refusals: list[str] = []
    trial = threading.Thread(target=lambda: refusals.extend(realtime.schedule_thread(priority)), name="trial")
    trial.start()
    trial.join()
    _, limit = resource.getrlimit(resource.RLIMIT_RTPRIO)
    if refusals:
        reason = refusals[0].partition(" (")[0]
        advice = f"{realtime.FIFO_REMEDY}; ticks are late beside other programs then"
        return Check(REALTIME, "warning", f"{reason}, the limit is rtprio {limit}", advice)
    return Check(REALTIME, "ok", f"SCHED_FIFO {priority} is permitted")


def check_autogroup(files: SystemFiles, *, realtime_permitted: bool) -> Check:
    """Whether the kernel shares the processors by sessions, which only ordinary scheduling feels (sched(7))."""
    enabled = files.text("proc/sys/kernel/sched_autogroup_enabled")
    if enabled != "1":
        return Check(AUTOGROUP, "ok", "off" if enabled else "this kernel has none")
    if realtime_permitted:
        return Check(AUTOGROUP, "ok", "on; threads under SCHED_FIFO are not in a group")
    return Check(
        AUTOGROUP,
        "warning",
        "on: a build in another session gets as much of the processors as the flight, whatever `nice` says",
        "sudo sysctl kernel.sched_autogroup_enabled=0, or permit real-time scheduling",
    )


def check_memory_lock() -> Check:
    """Whether this process can be locked into memory, and for how much; unlocked again afterwards."""
    limit, _ = resource.getrlimit(resource.RLIMIT_MEMLOCK)
    bound = "without a limit" if limit == resource.RLIM_INFINITY else f"up to {limit / 2**20:.1f} MiB"
    refusal = realtime.lock_memory()
    realtime.unlock_memory()
    if refusal:
        return Check(MEMORY, "warning", f"{refusal.partition(' (')[0]}; allowed {bound}", realtime.MEMORY_REMEDY)
    if not realtime.locks_later_memory():
        measured = f"locked; memory that is asked for later is not: allowed {bound}"
        return Check(MEMORY, "warning", measured, realtime.MEMORY_REMEDY)
    return Check(MEMORY, "ok", "locked, and what is asked for later as well")
