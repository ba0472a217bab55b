"""A signing key is a file of one user, read whole or refused, and shown nowhere."""

from __future__ import annotations

import os
import pickle
import stat
from pathlib import Path

import msgspec
import pytest

from dynamics.errors import RequestError
from dynamics.signing_key import SigningKey, read_signing_key, signing_ticks, write_signing_key

SECRET = bytes(range(1, 33))


def key_file(folder: Path, content: bytes, mode: int = 0o600) -> Path:
    path = folder / "link.key"
    path.write_bytes(content)
    path.chmod(mode)
    return path


@pytest.mark.parametrize(
    "content",
    [SECRET, SECRET.hex().encode(), SECRET.hex().upper().encode() + b"\n"],
    ids=["raw", "hex", "HEX and line"],
)
def test_a_key_is_32_bytes_or_64_hexadecimal_digits(content: bytes, tmp_path: Path) -> None:
    assert read_signing_key(key_file(tmp_path, content)).secret == SECRET


@pytest.mark.parametrize(
    "content",
    [b"", SECRET[:-1], SECRET + b"\n", SECRET.hex().encode()[:-1], b"g" * 64, bytes(32), b"0" * 64, b"x" * 10_000],
    ids=["empty", "31 bytes", "33 bytes", "63 digits", "no digits", "zero", "zero digits", "long"],
)
def test_what_is_no_key_is_refused_without_showing_it(content: bytes, tmp_path: Path) -> None:
    with pytest.raises(RequestError, match=r"link\.key.*32 bytes") as refusal:
        read_signing_key(key_file(tmp_path, content))
    text = f"{refusal.value!r} {refusal.value}"
    assert SECRET.hex()[:16] not in text
    assert str(SECRET[:8]) not in text


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o620, 0o602, 0o644, 0o666, 0o610])
def test_a_key_that_others_may_read_or_write_is_refused(mode: int, tmp_path: Path) -> None:
    with pytest.raises(RequestError, match=rf"mode {mode:o}.*chmod 600"):
        read_signing_key(key_file(tmp_path, SECRET, mode))


def test_a_key_of_another_user_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, own = key_file(tmp_path, SECRET), os.geteuid()
    monkeypatch.setattr(os, "geteuid", lambda: own + 1)
    with pytest.raises(RequestError, match="belongs to user"):
        read_signing_key(path)


def test_what_is_no_file_is_refused_at_once(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe", 0o600)
    for path in (tmp_path / "pipe", tmp_path, tmp_path / "missing"):
        with pytest.raises(RequestError, match=str(path)):
            read_signing_key(path)


def test_a_new_key_is_random_whole_and_for_its_user_alone(tmp_path: Path) -> None:
    before = os.umask(0)
    try:
        keys = [write_signing_key(tmp_path / name) for name in ("a.key", "b.key")]
    finally:
        os.umask(before)
    assert keys[0].secret != keys[1].secret
    assert read_signing_key(tmp_path / "a.key").secret == keys[0].secret
    assert stat.S_IMODE((tmp_path / "a.key").stat().st_mode) == 0o600
    with pytest.raises(RequestError, match="exists and is left as it is"):
        write_signing_key(tmp_path / "a.key")
    assert read_signing_key(tmp_path / "a.key").secret == keys[0].secret
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.key", "b.key"]
    with pytest.raises(RequestError, match="cannot write"):
        write_signing_key(tmp_path / "missing" / "c.key")


def test_a_key_shows_itself_in_no_text() -> None:
    key = SigningKey(SECRET, "link.key")
    assert repr(key) == str(key) == "SigningKey('link.key')"
    assert SECRET.hex()[:16] not in key.fingerprint
    for write in (msgspec.json.encode, pickle.dumps):
        with pytest.raises(TypeError):
            write(key)


def test_timestamps_count_10_us_since_2015() -> None:
    assert signing_ticks(1_420_070_400.0) == 0
    assert signing_ticks(1_420_070_401.5) == 150_000
    assert signing_ticks(0.0) == 0  # a computer without a clock
