"""Seeded mutations of bytes and of text: what a disk, a transfer, an editor or an attacker does to a file."""

from __future__ import annotations

import random
import struct
from collections.abc import Callable, Mapping, Sequence

Parts = Mapping[str, bytes]  # of one input: contents by name, such as the members of an archive
MAX_BYTES = 400_000  # of a mutated part: a find of more says nothing that a smaller one does not

NUMBERS = (0, 1, 2, 0x7F, 0x80, 0xFF, 0x7FFF, 0x8000, 0xFFFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, 2**63 - 1, 2**64 - 1)
FLOATS = (float("nan"), float("inf"), -float("inf"), 1e308, -1e308, 5e-324, -0.0)
WORDS = (
    b"nan", b"inf", b"-inf", b"1e999", b"-1e308", b"1e-320", b"0", b"-1", b"9" * 5000, b"9" * 25, b"0x1", b"1_000",
    b"null", b"true", b'""', b"''", b"{}", b"[]", b"[" * 5000, b'{"a":' * 3000, b"\xff\xfe", b"\x80", b"\0",
    b"\xef\xbb\xbf", b"\x1b[31m", b"\r", b"\n", b"\n\n", b",", b";", b"\t", b'"', b"'", b'"""', b"#", b"=", b".", b"..",
    b"../../x", b"/etc/passwd",
    b"a." * 3000 + b"a", b"0000-99-99", b"1979-05-27T07:32:00Z", b"\\ud800", b"\\u0000", b"%s%n", b"A" * 70_000,
    "−1".encode(), "é".encode(), "\U0001f600".encode(),
)  # fmt: skip


def mutated(parts: Parts, rng: random.Random, *, others: Sequence[Parts] = ()) -> dict[str, bytes]:
    """An input with a few changes to one or two of its parts.

    others: inputs of the same kind, of which pieces are taken.
    """
    result = dict(parts)
    for _ in range(rng.choice((1, 1, 1, 2))):
        name = rng.choice(sorted(result))
        donor = rng.choice(others).get(name, b"") if others else b""
        data = result[name]
        for _ in range(rng.choice((1, 1, 2, 3, 8))):
            data = rng.choice(TEXT_MUTATIONS if _is_text(data) else MUTATIONS)(data, rng, donor)[:MAX_BYTES]
        result[name] = data
    return result


def _is_text(data: bytes) -> bool:
    return b"\0" not in data[:1000]


def _span(data: bytes, rng: random.Random) -> tuple[int, int]:
    start = rng.randrange(len(data) + 1)
    return start, min(len(data), start + rng.choice((1, 2, 4, 8, 16, 64, 500)))


def _flip_bit(data: bytes, rng: random.Random, _: bytes) -> bytes:
    if not data:
        return data
    changed = bytearray(data)
    changed[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    return bytes(changed)


def _set_byte(data: bytes, rng: random.Random, _: bytes) -> bytes:
    if not data:
        return data
    changed = bytearray(data)
    changed[rng.randrange(len(data))] = rng.randrange(256)
    return bytes(changed)


def _early_byte(data: bytes, rng: random.Random, _: bytes) -> bytes:
    """Headers decide most."""
    if not data:
        return data
    changed = bytearray(data)
    changed[rng.randrange(min(len(data), 200))] = rng.choice((0, 1, 0x7F, 0x80, 0xFF, rng.randrange(256)))
    return bytes(changed)


def _overwrite_number(data: bytes, rng: random.Random, _: bytes) -> bytes:
    form = rng.choice("BHIQ")
    packed = struct.pack(rng.choice("<>") + form, rng.choice(NUMBERS) % (1 << (8 * struct.calcsize(form))))
    start = rng.randrange(len(data) + 1)
    return data[:start] + packed + data[start + len(packed) :]


def _overwrite_float(data: bytes, rng: random.Random, _: bytes) -> bytes:
    value = rng.choice(FLOATS)
    form = "d" if abs(value) > 3e38 and abs(value) != float("inf") else rng.choice("fd")
    packed = struct.pack("<" + form, value)
    start = rng.randrange(len(data) + 1)
    return data[:start] + packed + data[start + len(packed) :]


def _delete(data: bytes, rng: random.Random, _: bytes) -> bytes:
    start, end = _span(data, rng)
    return data[:start] + data[end:]


def _repeat(data: bytes, rng: random.Random, _: bytes) -> bytes:
    start, end = _span(data, rng)
    return data[:end] + data[start:end] * rng.choice((1, 2, 50)) + data[end:]


def _insert(data: bytes, rng: random.Random, _: bytes) -> bytes:
    start = rng.randrange(len(data) + 1)
    return data[:start] + rng.randbytes(rng.choice((1, 2, 4, 30, 300))) + data[start:]


def _cut(data: bytes, rng: random.Random, _: bytes) -> bytes:
    return data[: rng.randrange(len(data) + 1)]


def _zero(data: bytes, rng: random.Random, _: bytes) -> bytes:
    start, end = _span(data, rng)
    return data[:start] + rng.choice((b"\0", b"\xff")) * (end - start) + data[end:]


def _splice(data: bytes, rng: random.Random, donor: bytes) -> bytes:
    start, end = _span(donor, rng)
    place = rng.randrange(len(data) + 1)
    return data[:place] + donor[start:end] + data[place + rng.choice((0, end - start)) :]


def _swap(data: bytes, rng: random.Random, _: bytes) -> bytes:
    middle, end = sorted((rng.randrange(len(data) + 1), rng.randrange(len(data) + 1)))
    start, end = max(0, middle - 100), min(end, middle + 100)
    return data[:start] + data[middle:end] + data[start:middle] + data[end:]


def _word(data: bytes, rng: random.Random, _: bytes) -> bytes:
    start, end = _span(data, rng)
    return data[:start] + rng.choice(WORDS) + data[rng.choice((start, end)) :]


def _token(data: bytes, rng: random.Random, _: bytes) -> bytes:
    """Replace what stands between two separators, as a value of a table or a cell."""
    marks = [i for i, byte in enumerate(data[:20_000]) if byte in b',;= \n\t:[]{}"']
    if len(marks) < 2:
        return _word(data, rng, b"")
    place = rng.randrange(len(marks) - 1)
    value = rng.choice((*WORDS, str(rng.choice(NUMBERS)).encode(), repr(rng.choice(FLOATS)).encode(), b""))
    return data[: marks[place] + 1] + value + data[marks[place + 1] :]


def _line(data: bytes, rng: random.Random, donor: bytes) -> bytes:
    """Lose, repeat, move or import a line."""
    lines = data.split(b"\n")
    place, action = rng.randrange(len(lines)), rng.randrange(4)
    if action == 0:
        del lines[place]
    elif action == 1:
        lines.insert(rng.randrange(len(lines) + 1), lines[place])
    elif action == 2:
        lines.append(lines.pop(place))
    else:
        lines.insert(place, rng.choice(donor.split(b"\n")))
    return b"\n".join(lines)


Change = Callable[[bytes, random.Random, bytes], bytes]
MUTATIONS: tuple[Change, ...] = (
    _flip_bit, _set_byte, _early_byte, _early_byte, _overwrite_number, _overwrite_number, _overwrite_float, _delete,
    _repeat, _insert, _cut, _zero, _splice, _swap, _word,
)  # fmt: skip
TEXT_MUTATIONS: tuple[Change, ...] = (
    _flip_bit, _set_byte, _delete, _repeat, _insert, _cut, _splice, _swap, _word, _word, _token, _token, _token,
    _token, _line, _line,
)  # fmt: skip
