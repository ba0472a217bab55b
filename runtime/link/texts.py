"""STATUSTEXT: texts longer than 50 characters travel in chunks that share an id (MAVLink common.xml, STATUSTEXT)."""

from __future__ import annotations

from runtime.link.dialect import Message, mavlink
from runtime.link.telemetry import Text

CHUNK = 50
_MAX_LENGTH = CHUNK * 255
_PATIENCE = 1.0  # s to wait for a missing chunk


def text_messages(text: str, severity: int, identity: int) -> list[Message]:
    """The messages of a text. identity: 1..65535, different for texts sent close together."""
    data = text.encode("ascii", "replace")[:_MAX_LENGTH]
    if len(data) <= CHUNK:
        return [mavlink.MAVLink_statustext_message(severity, data)]
    chunks = [data[at : at + CHUNK] for at in range(0, len(data), CHUNK)]
    if len(chunks[-1]) == CHUNK:
        chunks.append(b"")  # a text ends with the first chunk that has room for a terminator
    return [
        mavlink.MAVLink_statustext_message(severity, chunk, identity, number) for number, chunk in enumerate(chunks)
    ]


class TextAssembler:
    """Joins one sender's chunked texts; a missing chunk is marked by [...]."""

    def __init__(self) -> None:
        self._identity = 0
        self._severity = 0
        self._since = 0.0
        self._chunks: dict[int, str] = {}

    def handle(self, message: Message, received: float) -> list[Text]:
        """The texts that this message completes."""
        if not message.id:
            return [*self.expire(received, patience=0.0), Text(received, message.severity, message.text)]
        texts = self.expire(received, patience=0.0) if message.id != self._identity else []
        if not self._chunks:
            self._identity, self._severity, self._since = message.id, message.severity, received
        self._chunks[message.chunk_seq] = message.text
        last = max(self._chunks)
        if len(self._chunks[last]) < CHUNK and len(self._chunks) == last + 1:
            texts += self.expire(received, patience=0.0)
        return texts

    def expire(self, now: float, patience: float = _PATIENCE) -> list[Text]:
        """The text that has waited longer than `patience` s for a missing chunk, if there is one."""
        if not self._chunks or now - self._since < patience:
            return []
        parts = [self._chunks.get(number, "[...]") for number in range(max(self._chunks) + 1)]
        self._chunks = {}
        return [Text(now, self._severity, "".join(parts))]
