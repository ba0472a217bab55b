"""Lost bytes of a serial line are reported with their number, not for each of them, and not for how a line begins."""

from __future__ import annotations

from runtime.link.line_noise import CHECK_PERIOD, REPORT_PERIOD, LineNoise


def reports(skipped: list[int], noise: LineNoise | None = None, start: float = 100.0) -> list[str]:
    """Reports of a line whose parser has skipped so many bytes at each look."""
    noise = noise or LineNoise(is_serial=True)
    texts = (noise.check(start + number * CHECK_PERIOD, count) for number, count in enumerate(skipped))
    return [text for text in texts if text]


def test_a_line_that_loses_nothing_is_not_reported() -> None:
    assert reports([0] * 60) == []
    assert reports([17] * 60) == []  # reading began amidst a frame


def test_the_first_loss_is_reported_at_once_and_the_others_together() -> None:
    first, second = reports([0, 0, 5, *range(6, 25)])
    assert first.startswith("5 bytes within 2 s belong to no frame")
    assert second.startswith(f"{round(REPORT_PERIOD)} bytes within {REPORT_PERIOD:.0f} s")


def test_a_line_that_was_opened_anew_begins_anew() -> None:
    noise = LineNoise(is_serial=True)
    assert len(reports([0, 300], noise)) == 1
    noise.restart()
    assert reports([40, 40, 40], noise, start=200.0) == []
    [text] = reports([42], noise, start=300.0)
    assert text.startswith("2 bytes")


def test_datagrams_that_are_no_mavlink_are_no_noise_of_a_line() -> None:
    assert reports([0, 300], LineNoise(is_serial=False)) == []
