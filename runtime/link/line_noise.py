"""Bytes of a serial line that belong to no frame: lost or changed on the way."""

from __future__ import annotations

REPORT_PERIOD = 10.0  # s between reports
CHECK_PERIOD = 1.0  # s between looks; the first of a line only counts, as reading begins amidst a frame


class LineNoise:
    """Reports bytes that a parser has skipped since the report before. Times are arguments, s, monotonic."""

    def __init__(self, *, is_serial: bool) -> None:
        """is_serial: whether it is a serial line; UDP and TCP lose and change no single bytes."""
        self._is_serial = is_serial
        self._since = self._looked = self._reported = float("-inf")
        self._skipped: int | None = None

    def restart(self) -> None:
        """Begin again with a line that was opened anew, and its parser."""
        self._skipped = None

    def check(self, now: float, skipped_bytes: int) -> str:
        """A line about new losses, else empty. skipped_bytes: of the parser so far."""
        if not self._is_serial or now - self._looked < CHECK_PERIOD:
            return ""
        self._looked = now
        if self._skipped is None:
            self._skipped, self._since = skipped_bytes, now
        lost = skipped_bytes - self._skipped
        if not lost or now - self._reported < REPORT_PERIOD:
            return ""
        seconds = now - self._since
        self._skipped, self._since, self._reported = skipped_bytes, now, now
        return (
            f"{lost} bytes within {seconds:.0f} s belong to no frame: the line loses or changes bytes. Check common "
            "ground and the wires' length, the baud rate on both sides, and what else loads this computer."
        )
