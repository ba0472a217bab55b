"""What libraries print stays off the terminal, compiled ones' as well."""

from __future__ import annotations

import ctypes
import os
import sys

import pytest

from flights.library_output import captured_output


def test_python_and_compiled_code_print_into_the_capture(capfd: pytest.CaptureFixture[str]) -> None:
    libc = ctypes.CDLL(None)
    with captured_output() as output:
        libc.puts(b"of compiled code")  # into a buffer of C's
        os.write(2, b"of a descriptor\n" * 10_000)  # more than is kept, which must not block
    assert output.first_line in ("of compiled code", "of a descriptor")
    with captured_output() as output:
        print("of Python", file=sys.stderr)
    assert output.first_line == "of Python"
    print("after it")
    assert capfd.readouterr() == ("after it\n", "")


def test_nothing_is_captured_where_nothing_is_printed() -> None:
    with captured_output() as output:
        pass
    assert output.first_line == ""
