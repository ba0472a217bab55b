"""STATUSTEXT: texts longer than one message are cut into numbered chunks with a common id."""

from __future__ import annotations

from sitl_mock.wire.dialect import Message, mavlink

CHUNK = 50


class TextWriter:
    """Makes STATUSTEXT messages of texts of any length."""

    def __init__(self) -> None:
        self._id = 0

    def messages(self, severity: int, text: str) -> list[Message]:
        """One message, or several with the same id and chunk_seq 0, 1, 2, ... when longer than 50 characters."""
        raw = text.encode("ascii", "replace")
        if len(raw) <= CHUNK:
            return [mavlink.MAVLink_statustext_message(severity, raw, 0, 0)]
        self._id = self._id % 0xFFFF + 1
        chunks = [raw[start : start + CHUNK] for start in range(0, len(raw), CHUNK)]
        if len(chunks[-1]) == CHUNK:
            chunks.append(b"")  # a receiver recognises the end by a chunk that is not full
        return [
            mavlink.MAVLink_statustext_message(severity, chunk, self._id, number) for number, chunk in enumerate(chunks)
        ]
