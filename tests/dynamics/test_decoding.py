"""Whatever is wrong with a text or a file of arrays, there is one kind of error."""

from __future__ import annotations

import contextlib
import tomllib
import zipfile
from pathlib import Path

import msgspec
import numpy as np
import pytest

from dynamics.array_file import read_arrays
from dynamics.decoding import decode_json, editable_toml, parse_toml
from dynamics.errors import RequestError

BROKEN = ("a = " + "9" * 5000, "a = " + "[" * 5000, "a = [", "a = 0000-99-99", "a = '\x01'", "a" + ".a" * 5000)


@pytest.mark.parametrize("text", BROKEN, ids=lambda text: text[:10])
def test_toml_that_cannot_be_read_is_a_decode_error(text: str) -> None:
    for read in (parse_toml, editable_toml):
        with contextlib.suppress(tomllib.TOMLDecodeError):  # keys that nest are TOML, where the stack allows them
            read(text)
    assert parse_toml("a = 1") == {"a": 1}
    assert editable_toml("a = 1 # one").as_string() == "a = 1 # one"


@pytest.mark.parametrize("content", [b'["\xff"]', b"[" * 100_000, b'{"a":' * 100_000, b"9" * 5000, b"", '"\ud800"'])
def test_json_that_cannot_be_read_is_an_error_of_msgspec(content: bytes | str) -> None:
    with pytest.raises(msgspec.MsgspecError):
        decode_json(content, dict[str, int])


def _member(path: Path, content: bytes, method: int = zipfile.ZIP_STORED) -> Path:
    with zipfile.ZipFile(path, "w", method) as archive:
        archive.writestr("a.npy", content)
    return path


def test_a_damaged_file_of_arrays_is_refused_with_advice(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    np.savez(path, a=np.arange(5.0))
    intact = path.read_bytes()
    assert read_arrays(path, advice="")["a"][4] == 4.0
    damaged = [intact[:40], intact[:-30], b"", b"PK\x03\x04", intact.replace(b"NUMPY", b"NUMPX")]
    for content in damaged:
        path.write_bytes(content)
        with pytest.raises(RequestError, match="Export again"):
            read_arrays(path, advice="Export again.")
    header = b"\x93NUMPY\x01\x00\x76\x00"
    members = [
        b"",
        b"no array",
        header + b"{" * 118,
        header + b"('" * 59,
        header + b"{'shape': (9" + b"9" * 105 + b"\n",
    ]
    for content in members:
        with pytest.raises(RequestError, match="Export again"):
            read_arrays(_member(path, content), advice="Export again.")
    np.savez(path, a=np.array(["text"]))
    with pytest.raises(RequestError, match="no numbers"):
        read_arrays(path, advice="")
