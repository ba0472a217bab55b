"""Mutated datagrams to the tick in C, under the address and undefined-behaviour sanitizers."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import pytest

from runtime.flight.health import HealthLimits
from runtime.link.dialect import mavlink
from runtime.link.estimate import EstimateLimits
from runtime.tick import context
from runtime.tick.library import tick_sources
from tests.fuzz.sanitized import compiled, run, why_not
from tests.support.fake_vehicle import odometry
from tests.support.tick_in_c import library

HERE = Path(__file__).parent
DATAGRAMS = 20_000


@pytest.mark.skipif(bool(why_not()), reason=why_not())
@pytest.mark.parametrize("seed", [1, 2])
def test_no_datagram_reaches_beyond_its_bytes(seed: int, tmp_path: Path) -> None:
    for name, text in {**tick_sources(), "tick_driver.c": (HERE / "tick_driver.c").read_text()}.items():
        (tmp_path / name).write_text(text)
    structs = library().structs
    messages, limits = structs["alula_messages"](), structs["alula_limits"]()
    context.write_messages(messages)
    context.write_limits(limits, EstimateLimits(), HealthLimits())
    plain, signed = mavlink.MAVLink(None, 1, 1), mavlink.MAVLink(None, 1, 1)
    signed.signing.secret_key, signed.signing.sign_outgoing, signed.signing.timestamp = bytes(32), True, 1
    datagrams: list[Any] = [bytes(odometry().pack(packer)) for packer in (plain, signed)]
    content = bytes(messages) + bytes(limits) + b"".join(struct.pack("<i", len(each)) + each for each in datagrams)
    done = run(compiled(tmp_path, "tick_driver.c", (), ["-lm"]), content, seed, DATAGRAMS)
    assert done.returncode == 0, done.stderr.decode()[-3000:]
    assert int(done.stdout) > DATAGRAMS / 200  # some are whole, and go all the way
