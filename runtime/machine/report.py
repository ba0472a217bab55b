"""All checks of the computer, and whether a flight is possible with it."""

from __future__ import annotations

from pathlib import Path

import msgspec

from dynamics import symbolic
from dynamics.codegen import has_compiler
from dynamics.errors import AlulaError
from runtime.control.bundle import Bundle
from runtime.flight_setup import exported_bundle, flown_vehicle_text
from runtime.link.connection import Endpoint
from runtime.link.transport import open_transport
from runtime.machine import kernels, processors, scheduling
from runtime.machine.check import Check, SystemFiles

LINK, BUNDLE = "link", "bundle"


class MachineReport(msgspec.Struct, frozen=True):
    """The checks of a computer."""

    checks: tuple[Check, ...]

    @property
    def can_fly(self) -> bool:
        """Whether no check found a problem; warnings make a flight worse, not impossible."""
        return all(check.state != "problem" for check in self.checks)


def check_machine(
    endpoint: Endpoint, *, bundle: Path | None, priority: int, files: SystemFiles | None = None
) -> MachineReport:
    """Check the computer that this process runs on; nothing is sent, and nothing is left but an empty cache folder.

    endpoint: of the link that will be flown. bundle: that will be flown, None for a vehicle file. priority: of
    SCHED_FIFO. files: of the kernel, by default this computer's.
    """
    files = files or SystemFiles()
    exported, checks = _bundle(bundle)
    if exported is None:
        cache = kernels.check_cache()
        compiler = kernels.check_compiler(cache_usable=cache.state == "ok")
        compiles = symbolic.is_installed() and has_compiler()
        checks += [_needed_by(each, compiles=compiles) for each in (compiler, cache)]
    else:
        checks += [Check(name, "ok", kernels.NOT_NEEDED) for name in (kernels.COMPILER, kernels.CACHE)]
    checks.append(kernels.check_simd(exported))
    realtime = scheduling.check_realtime(priority)
    checks += [
        realtime,
        scheduling.check_autogroup(files, realtime_permitted=realtime.state == "ok"),
        scheduling.check_memory_lock(),
        processors.check_governor(files),
        processors.check_throttling(files),
        processors.check_clock(files),
        check_link(endpoint),
    ]
    return MachineReport(tuple(checks))


def check_link(endpoint: Endpoint) -> Check:
    """Whether the link's port is free, its device there and permitted; it is opened and closed again."""
    try:
        open_transport(endpoint).close()
    except AlulaError as error:
        refusal, _, advice = str(error).partition(": ")
        return Check(LINK, "problem", refusal, advice)
    return Check(LINK, "ok", f"{endpoint} can be opened")


def _bundle(folder: Path | None) -> tuple[Bundle | None, list[Check]]:
    """The bundle, where it can be read, and the check of it."""
    try:
        if folder is not None:
            flown_vehicle_text(None, folder)
        exported = exported_bundle(folder)
    except AlulaError as error:
        return None, [Check(BUNDLE, "problem", str(error), "export the model again")]
    if exported is None:
        return None, []
    return exported, [Check(BUNDLE, "ok", f"{folder} is intact, for {exported.manifest.processor}")]


def _needed_by(check: Check, *, compiles: bool) -> Check:
    """The check of compiler or cache folder; at most a warning where controllers are not compiled here."""
    return check if compiles or check.state == "ok" else msgspec.structs.replace(check, state="warning")
