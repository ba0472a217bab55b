"""Checks that try something: what is refused is a warning or a problem with its remedy, and nothing stays changed."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from dynamics import symbolic
from runtime.control.rti.processor import native_processor
from runtime.link.connection import parse_endpoint
from runtime.machine import kernels
from runtime.machine import report as report_module
from runtime.machine.check import Check
from runtime.machine.report import MachineReport, check_link, check_machine
from simulation.mock_process import free_port

UNPRIVILEGED = """
import os, resource
from runtime.machine import scheduling
for limit in (resource.RLIMIT_RTPRIO, resource.RLIMIT_MEMLOCK):
    resource.setrlimit(limit, (0, 0))
if os.getuid() == 0:
    os.setgid(65534); os.setuid(65534)
for check in (scheduling.check_realtime(50), scheduling.check_memory_lock()):
    print(check.state, check.measured, check.advice, sep="|")
"""


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("ALULA_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


def test_what_is_not_permitted_is_a_warning_with_its_remedy() -> None:
    output = subprocess.run([sys.executable, "-c", UNPRIVILEGED], capture_output=True, text=True, check=True).stdout
    realtime, memory = (line.split("|") for line in output.splitlines())
    assert (realtime[0], memory[0]) == ("warning", "warning")
    assert "SCHED_FIFO 50 refused" in realtime[1]
    assert "rtprio 60" in realtime[2]
    assert "mlockall refused" in memory[1]
    assert "memlock unlimited" in memory[2]


def test_the_caller_stays_under_ordinary_scheduling(cache: Path) -> None:
    before = os.sched_getscheduler(0)
    endpoint = parse_endpoint(f"udpin:127.0.0.1:{free_port()}")
    report = check_machine(endpoint, bundle=None, priority=50)
    assert os.sched_getscheduler(0) == before
    assert report.can_fly
    assert list(cache.iterdir()) == []  # the trial of the compiler is removed
    assert check_link(endpoint).state == "ok"


def test_a_folder_of_code_that_cannot_be_written_is_a_problem(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setenv("ALULA_CACHE", str(tmp_path / "file"))
    check = kernels.check_cache()
    assert check.state == "problem"
    assert "ALULA_CACHE" in check.advice


def test_a_folder_of_code_that_nothing_is_compiled_into_is_a_warning(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ALULA_CACHE", "/dev/null/cache")
    monkeypatch.setattr(symbolic, "is_installed", lambda: False)
    report = check_machine(parse_endpoint(f"udpin:127.0.0.1:{free_port()}"), bundle=None, priority=50)
    states = {check.name: check.state for check in report.checks}
    assert states["cache folder"] == "warning"


def test_a_compiler_that_refuses_our_flags_is_a_problem(
    cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    compiler = tmp_path / "cc"
    compiler.write_text('#!/bin/sh\necho "old compiler 1.0"\n[ "$1" = --version ]\n')
    compiler.chmod(0o755)
    monkeypatch.setenv("CC", str(compiler))
    check = kernels.check_compiler(cache_usable=True)
    assert check.state == "problem"
    assert "old compiler 1.0" in check.measured
    assert "refused trial.c" in check.measured


def test_without_a_compiler_a_bundle_still_flies(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("CC", raising=False)
    check = kernels.check_compiler(cache_usable=True)
    assert check.state == "warning"
    assert "bundle" in check.advice


def test_a_taken_port_is_a_problem_and_a_free_one_is_not() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", 0))
        endpoint = parse_endpoint(f"udpin:127.0.0.1:{other.getsockname()[1]}")
        check = check_link(endpoint)
        assert check.state == "problem"
        assert "is taken" in check.advice
    assert check_link(endpoint).state == "ok"


def test_a_serial_device_that_is_not_there_is_a_problem() -> None:
    check = check_link(parse_endpoint("serial:/dev/ttyNONE:921600"))
    assert check.state == "problem"
    assert "no such device" in check.advice


def test_a_folder_that_is_no_bundle_is_a_problem(cache: Path, tmp_path: Path) -> None:
    report = check_machine(parse_endpoint(f"udpin:127.0.0.1:{free_port()}"), bundle=tmp_path, priority=50)
    assert not report.can_fly
    assert [check.name for check in report.checks if check.state == "problem"] == ["bundle"]


def test_a_bundle_needs_neither_compiler_nor_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    exported = SimpleNamespace(manifest=SimpleNamespace(processor=native_processor().name))
    monkeypatch.setattr(report_module, "exported_bundle", lambda folder: exported)
    monkeypatch.setattr(report_module, "flown_vehicle_text", lambda vehicle, folder: "")
    monkeypatch.setenv("ALULA_CACHE", "/dev/null/cache")
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("CC", raising=False)
    report = check_machine(parse_endpoint(f"udpin:127.0.0.1:{free_port()}"), bundle=tmp_path, priority=50)
    assert report.can_fly
    measured = {check.name: check.measured for check in report.checks}
    assert measured["compiler"] == measured["cache folder"] == kernels.NOT_NEEDED
    assert native_processor().name in measured["SIMD"]


@pytest.mark.parametrize(("states", "can_fly"), [(["ok", "warning"], True), (["ok", "problem"], False)])
def test_a_warning_does_not_forbid_a_flight(states: list[str], can_fly: bool) -> None:
    report = MachineReport(tuple(Check("name", state, "") for state in states))  # type: ignore[arg-type]
    assert report.can_fly == can_fly
