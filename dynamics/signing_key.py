"""The key file of MAVLink 2 signing: one secret of 32 bytes that no other user may read.

A key is never shown: not by its text forms, not in errors, and it cannot be written into JSON or a pickle by accident.
"""

from __future__ import annotations

import hashlib
import hmac
import os
import re
import secrets
import stat
import tempfile
from pathlib import Path
from typing import NoReturn

from dynamics.errors import RequestError

KEY_BYTES = 32
TICKS = 100_000  # of its timestamps in a second
EPOCH = 1_420_070_400  # unix time of 2015-01-01, GMT, s
_HEXADECIMAL = re.compile(rb"[0-9A-Fa-f]{64}")
_MAX_BYTES = 4096
_FORMAT = "Wanted 32 bytes, or their 64 hexadecimal digits"


class SigningKey:
    """The secret that both ends of a signed link hold.

    name: of its file, for messages.
    """

    __slots__ = ("_keyed", "_secret", "name")

    def __init__(self, secret: bytes, name: str = "a key") -> None:
        """secret: 32 bytes, not all of them 0, which is how a system is told to sign no more."""
        if len(secret) != KEY_BYTES or not any(secret):
            raise RequestError(f"{name} holds no signing key. {_FORMAT}, not all 0.")
        self._secret, self.name = bytes(secret), name
        self._keyed = hashlib.sha256(self._secret)

    @property
    def secret(self) -> bytes:
        """The 32 bytes, for a packer alone."""
        return self._secret

    @property
    def fingerprint(self) -> str:
        """16 digits that tell keys apart, for the name of a file of this user."""
        return hmac.new(self._secret, b"alula: name of a signing key", hashlib.sha256).hexdigest()[:16]

    def signature(self, data: bytes) -> bytes:
        """The first 48 bits of SHA-256 over key and data. data: a frame with link id and timestamp."""
        digest = self._keyed.copy()
        digest.update(data)
        return digest.digest()[:6]

    def __repr__(self) -> str:
        return f"SigningKey({self.name!r})"

    def __reduce__(self) -> NoReturn:
        raise TypeError("a signing key stays in its process")


def signing_ticks(unix: float) -> int:
    """The timestamp of a unix time, s: 10 us since 2015."""
    return max(0, int((unix - EPOCH) * TICKS))


def read_signing_key(path: Path) -> SigningKey:
    """The key of a file. Raises RequestError for a file of another user, one that others may read, and for no key."""
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError as error:
        raise RequestError(
            f"cannot read the signing key {path}: {error.strerror or error}. "
            f"Give a key file, or make one: alula link --new-signing-key {path}"
        ) from None
    try:
        _require_secret(path, os.fstat(descriptor))
        content = os.read(descriptor, _MAX_BYTES + 1)
    finally:
        os.close(descriptor)
    if len(content) == KEY_BYTES:
        return SigningKey(content, str(path))
    digits = content.strip()
    if not _HEXADECIMAL.fullmatch(digits):
        size = f"{len(content)} bytes" if len(content) <= _MAX_BYTES else f"more than {_MAX_BYTES} bytes"
        raise RequestError(
            f"{path} holds {size}, and no signing key. {_FORMAT}; alula link --new-signing-key FILE makes one."
        )
    return SigningKey(bytes.fromhex(digits.decode("ascii")), str(path))


def write_signing_key(path: Path) -> SigningKey:
    """Write a new random key as hexadecimal digits: whole or not at all, readable by this user alone.

    Raises RequestError where the file exists, because a key that is overwritten locks its user out of the vehicle.
    """
    key = SigningKey(secrets.token_bytes(KEY_BYTES), str(path))
    part = None
    try:
        descriptor, part = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}-")  # of mode 600
        with os.fdopen(descriptor, "wb") as file:
            file.write(key.secret.hex().encode("ascii") + b"\n")
            file.flush()
            os.fsync(descriptor)
        os.link(part, path)  # fails where the path exists, as a rename would not
    except FileExistsError:
        raise RequestError(f"{path} exists and is left as it is. Give a new name, or move that file away.") from None
    except OSError as error:
        raise RequestError(
            f"cannot write the signing key {path}: {error.strerror or error}. Give a file in a folder of yours."
        ) from None
    finally:
        if part is not None:
            os.unlink(part)
    return key


def _require_secret(path: Path, status: os.stat_result) -> None:
    """Raise RequestError for a key that is no file of this user's alone."""
    if not stat.S_ISREG(status.st_mode):
        raise RequestError(f"the signing key {path} is no file. {_FORMAT} in a file of yours.")
    if status.st_uid != os.geteuid():
        raise RequestError(
            f"the signing key {path} belongs to user {status.st_uid}, and who owns it can change it. "
            f"Copy it: install -m 600 {path} mine.key"
        )
    if status.st_mode & (stat.S_IRWXG | stat.S_IRWXO):
        mode = stat.S_IMODE(status.st_mode)
        raise RequestError(f"the signing key {path} has mode {mode:o}: others may read it. Then: chmod 600 {path}")
