"""Every usual spelling of a link is understood, and every other is refused with the spellings that are."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dynamics.errors import RequestError
from runtime.link.connection import DEFAULT_BAUD, Endpoint, parse_endpoint


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("udpin:0.0.0.0:14540", Endpoint("udpin", "0.0.0.0", 14540)),
        ("udpout:127.0.0.1:14580", Endpoint("udpout", "127.0.0.1", 14580)),
        ("tcp:127.0.0.1:5760", Endpoint("tcpout", "127.0.0.1", 5760)),
        ("tcpout:10.0.0.2:5760", Endpoint("tcpout", "10.0.0.2", 5760)),
        ("tcpin:0.0.0.0:5760", Endpoint("tcpin", "0.0.0.0", 5760)),
        ("serial:/dev/ttyACM0:921600", Endpoint("serial", device="/dev/ttyACM0", baud=921600)),
        ("serial:/dev/ttyUSB0", Endpoint("serial", device="/dev/ttyUSB0", baud=DEFAULT_BAUD)),
        # MAVSDK
        ("udp://:14540", Endpoint("udpin", "0.0.0.0", 14540)),
        ("udpin://0.0.0.0:14540", Endpoint("udpin", "0.0.0.0", 14540)),
        ("udpin://", Endpoint("udpin", "0.0.0.0", 14540)),
        ("udpout://192.168.1.12:14580", Endpoint("udpout", "192.168.1.12", 14580)),
        ("tcp://localhost:5760", Endpoint("tcpout", "localhost", 5760)),
        ("tcpin://0.0.0.0:5760", Endpoint("tcpin", "0.0.0.0", 5760)),
        ("tcpout://localhost:5760", Endpoint("tcpout", "localhost", 5760)),
        ("serial:///dev/ttyACM0:57600", Endpoint("serial", device="/dev/ttyACM0", baud=57600)),
        # pymavlink
        ("udp:127.0.0.1:14550", Endpoint("udpin", "127.0.0.1", 14550)),
        ("udpbcast:192.168.1.255:14550", Endpoint("udpout", "192.168.1.255", 14550)),
        ("/dev/ttyACM0", Endpoint("serial", device="/dev/ttyACM0", baud=DEFAULT_BAUD)),
        ("/dev/ttyACM0,57600", Endpoint("serial", device="/dev/ttyACM0", baud=57600)),
        (
            "/dev/serial/by-id/usb-Auterion_PX4_FMU_v6x-if00,57600",
            Endpoint("serial", device="/dev/serial/by-id/usb-Auterion_PX4_FMU_v6x-if00", baud=57600),
        ),
        ("COM3,57600", Endpoint("serial", device="COM3", baud=57600)),
        ("udpout:[::1]:14580", Endpoint("udpout", "::1", 14580)),
        (" UDPIN:0.0.0.0:14540 ", Endpoint("udpin", "0.0.0.0", 14540)),
    ],
)
def test_every_spelling_is_understood(text: str, expected: Endpoint) -> None:
    assert parse_endpoint(text) == expected


@pytest.mark.parametrize(
    "text",
    [
        "",
        "14540",
        "udpin",
        "localhost:14540",
        "http://localhost:80",
        "udpout::14580",
        "udpout:127.0.0.1",
        "tcp:127.0.0.1:99999",
        "udpin:0.0.0.0:port",
        "serial:",
        "serial:/dev/ttyACM0:0",
        "serial:/dev/a b",
        "udpin:a:b:c:1",
        "udpout:127.0.0.1:0",
        "tcpin:0.0.0.0",
    ],
)
def test_anything_else_is_refused_with_what_is_accepted(text: str) -> None:
    with pytest.raises(RequestError, match=r"udpin:0\.0\.0\.0:14540") as refusal:
        parse_endpoint(text)
    assert f"'{text}'" in str(refusal.value)


@given(st.text(max_size=40))
def test_no_text_does_anything_but_parse_or_be_refused(text: str) -> None:
    try:
        endpoint = parse_endpoint(text)
    except RequestError:
        return
    assert parse_endpoint(str(endpoint)) == endpoint
