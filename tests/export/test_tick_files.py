"""The tick in C of a bundle: a program of a user's own, compiled from it, answers the mock autopilot's bytes."""

from __future__ import annotations

import shutil
import socket
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from dynamics.codegen import find_compiler
from dynamics.errors import VehicleError
from export.bundle import Exported
from runtime.control.bundle import read_bundle
from runtime.control.controller import Controller
from runtime.flight.thrust import ThrustMap
from runtime.link.dialect import mavlink
from runtime.link.framing import FrameParser
from simulation.mock_process import free_port, mock_process
from tests.support.deadline import Deadline

FLAGS = ("-O2", "-Wall", "-Wextra", "-Werror", "-ffp-contract=off")


def program(folder: Path, kernel: str, to: Path) -> Path:
    """The example, as its first lines say."""
    tick = folder / "tick"
    sources = [str(tick / "tick_example.c"), str(tick / "tick.c"), str(folder / kernel)]
    subprocess.run([find_compiler(), *FLAGS, *sources, f"-Wl,-rpath,{folder}", "-o", str(to), "-lm"], check=True)
    return to


def flown(example: Path, answers: int) -> tuple[list[bytes], list[int]]:
    """Answers of the example to a mock's datagrams, and what it counted: answered, and left by reason."""
    port = free_port()
    with (
        mock_process() as mock,
        subprocess.Popen([example, str(port)], stdout=subprocess.PIPE, text=True) as node,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as from_mock,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as to_node,
    ):
        from_mock.bind(("127.0.0.1", mock.port))
        from_mock.settimeout(5.0)
        to_node.bind(("127.0.0.1", 0))
        to_node.setblocking(False)
        received, deadline = list[bytes](), Deadline(30.0)
        while len(received) < answers and not deadline.passed:
            to_node.sendto(from_mock.recv(65536), ("127.0.0.1", port))
            try:
                while True:
                    received.append(to_node.recv(300))
            except BlockingIOError:
                continue
            except ConnectionRefusedError:
                raise VehicleError("the example has ended") from None
        to_node.sendto(b"", ("127.0.0.1", port))
        assert node.stdout is not None
        counted = [int(part.split()[0]) for part in node.stdout.read().split(",")]
        assert node.wait(10.0) == 0
    return received, counted


@pytest.mark.realtime
@pytest.mark.long("compiles and exports, and a mock in real time")
@pytest.mark.parametrize(("kind", "kernel"), [("nominal", "kernel.so"), ("pi_tcn", "physics.so")])
def test_the_example_answers_the_mock_s_estimates(
    export_kind: Callable[[str], Exported], kind: str, kernel: str, tmp_path: Path
) -> None:
    folder = export_kind(kind).folder
    received, counted = flown(program(folder, kernel, tmp_path / "example"), answers=50)
    assert counted[0] >= len(received) >= 50
    assert not any(counted[place] for place in (2, 4, 6, 7, 8, 11, 14))  # frames, signature, axes, numbers, solver
    messages = [frame.message for data in received for frame in FrameParser().feed(data)]
    assert [message.get_srcSystem() for message in messages] == [1] * len(received)
    assert {message.get_type() for message in messages} == {"SET_ATTITUDE_TARGET"}
    assert all(message.type_mask == mavlink.ATTITUDE_TARGET_TYPEMASK_ATTITUDE_IGNORE for message in messages)
    trim = Controller.build(read_bundle(folder).vehicle).trim
    hover = ThrustMap(trim.rotors.thrust_max, trim.rotors.thrust_curve, 0.0).setpoint(trim.weight)
    rates = [(message.body_roll_rate, message.body_pitch_rate, message.body_yaw_rate) for message in messages]
    assert np.abs(rates[:10]).max() < 0.1  # it stands level; nothing it is sent moves it
    assert (np.abs(rates) <= trim.limits.rate).all()
    assert all(hover < message.thrust <= 1.0 for message in messages)  # and is to rise by a metre


def test_the_header_is_cxx_as_well(export_kind: Callable[[str], Exported], tmp_path: Path) -> None:
    folder, compiler = export_kind("nominal").folder / "tick", shutil.which("g++") or shutil.which("c++")
    if compiler is None:
        pytest.skip("no C++ compiler here")
    (tmp_path / "node.cpp").write_text(
        '#include "tick.h"\nint answer(alula_context &c, alula_result &r) { return alula_answer(&c, 0.0, &r); }\n'
    )
    subprocess.run(
        [compiler, "-std=c++17", "-Wall", "-Werror", f"-I{folder}", "-c", tmp_path / "node.cpp", "-o", tmp_path / "o"],
        check=True,
    )


def test_the_files_are_part_of_the_bundle_that_is_approved(export_kind: Callable[[str], Exported]) -> None:
    exported = export_kind("nominal")
    listed = {name for name in exported.manifest.files if name.startswith("tick/")}
    assert {"tick/tick.h", "tick/tick.c", "tick/tick_example.c", "tick/tick_vehicle.h"} <= listed
    assert "tick/receiver.c" not in listed
