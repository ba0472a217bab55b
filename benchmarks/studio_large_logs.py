"""Studio with a log of 2 GB: memory of the server and of the working process, and what the page says.

    python -m benchmarks.studio_large_logs [--size 2.0] [--memory 4.0]

A ULog of PX4 and a CSV of Alula's, laid end to end until they are so large, are dropped on the page in headless
Chromium. While each is read another case takes a log of usual size. Memory is the largest that was seen, twenty times
a second.
"""

from __future__ import annotations

import argparse
import gzip
import struct
import tempfile
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import psutil
from playwright.sync_api import Page, expect

from benchmarks.provenance import write_result
from benchmarks.studio import DATA, drop, new_case, studio_in_browser
from flights import Flight

SOURCE = "drag2_4_lemniscate"
HEADER, DATA_MESSAGE, SUBSCRIPTION = 16, ord("D"), ord("A")  # of a ULog: bytes, kinds of messages
PERIOD = 0.05  # s between two looks at the memory
PATIENCE = 1_200.0  # s


@dataclass
class Peak:
    """The largest memory of a server and of its working processes, bytes."""

    process: psutil.Process
    server: int = 0
    workers: int = 0
    _ended: threading.Event = field(default_factory=threading.Event)

    def __enter__(self) -> Peak:
        self._thread = threading.Thread(target=self._watch, daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join()

    def _watch(self) -> None:
        while not self._ended.wait(PERIOD):
            self.server = max(self.server, self.process.memory_info().rss)
            for child in self.process.children():
                try:
                    self.workers = max(self.workers, child.memory_info().rss)
                except psutil.NoSuchProcess:
                    continue


def large_ulog(original: bytes, size: int, path: Path) -> Path:
    """A ULog whose data follow each other again and again, later by a flight's length, until it is so large."""
    begin, stamps, place = len(original), [], HEADER
    while place + 3 <= len(original):
        length, kind = struct.unpack_from("<HB", original, place)
        if kind == DATA_MESSAGE:
            stamps.append(place + 5)  # behind the message's head and its number
        elif kind == SUBSCRIPTION:
            begin = place + 3 + length
        place += 3 + length
    stamps = [stamp for stamp in stamps if stamp > begin]
    content = np.frombuffer(original, dtype=np.uint8)[begin:place].copy()
    places = np.array(stamps)[:, None] - begin + np.arange(8)
    times = content[places].copy().view("<u8")[:, 0]
    step = np.uint64(int(times.max() - times.min()) + 4000)
    with path.open("wb") as file:
        file.write(original[:begin])
        while file.tell() < size:
            file.write(content.tobytes())
            times = times + step
            content[places] = times[:, None].view(np.uint8)
    return path


def large_csv(log: Path, size: int, path: Path) -> Path:
    """A CSV whose rows follow each other again and again until it is so large."""
    small = Path(Flight.read(log).to_csv(path.with_name("small.csv")))
    lines = small.read_text().splitlines()
    head = next(place for place, line in enumerate(lines) if not line.startswith("#"))
    rows = [line.partition(",") for line in lines[head + 1 :]]
    length = float(rows[-1][0]) - float(rows[0][0]) + 0.004
    with path.open("w") as file:
        file.write("\n".join(lines[: head + 1]) + "\n")
        number = 0
        while file.tell() < size:
            file.write("".join(f"{float(time) + number * length:.6f},{rest}\n" for time, _, rest in rows))
            number += 1
    return path


def answer(page: Page) -> str:
    """Text of the page about the log in the end."""
    began = time.monotonic()
    while time.monotonic() - began < PATIENCE:
        alert = page.locator("#main .mantine-Alert-message")
        if alert.count() and "needs" not in (text := alert.first.inner_text()):
            return text
        if page.locator("#log-lines .scatterlayer .trace").count():
            return "it is drawn"
        refused = page.locator("#log-list .mantine-Text-root[style*=red]")
        if refused.count():
            return refused.first.inner_text()
        page.wait_for_timeout(500)
    return "nothing"


def measure(page: Page, address: str, process: psutil.Process, log: Path, small: Path) -> str:
    """A row of the table: the upload, the answer, and another case meanwhile."""
    new_case(page, address)
    with Peak(process) as peak:
        began = time.perf_counter()
        with page.expect_file_chooser() as chosen:
            page.locator("#drop-logs .choose").click()
        chosen.value.set_files([str(log)])
        expect(page.locator("#drop-logs .answer")).to_have_text("1 file received", timeout=1e3 * PATIENCE)
        sent = time.perf_counter() - began
        assert page.context.browser is not None
        other = page.context.browser.new_page()
        new_case(other, address)
        meanwhile = drop(other, [small])
        text = answer(page)
        answered = time.perf_counter() - began
    other.close()
    figures = (peak.server / 1e6, peak.workers / 1e9)
    size = log.stat().st_size / 1e9
    return (
        f"| {log.suffix[1:]} | {size:.1f} | {sent:.0f} | {answered:.0f} | {figures[0]:.0f} | {figures[1]:.1f} | "
        f"{meanwhile:.1f} | {text} |"
    )


def main() -> None:
    """Make the logs, drop them and write the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=float, default=2.0, help="of a log, GB")
    parser.add_argument("--memory", type=float, default=4.0, help="that a working process may take, GB")
    options = parser.parse_args()
    rows = []
    with tempfile.TemporaryDirectory() as name:
        folder, size = Path(name), int(1e9 * options.size)
        small = folder / f"{SOURCE}.ulg"
        small.write_bytes(gzip.decompress((DATA / f"{SOURCE}.ulg.gz").read_bytes()))
        with studio_in_browser(folder, "--memory", str(options.memory)) as (page, address, process):
            for make, source in ((large_ulog, small.read_bytes()), (large_csv, small)):
                log = make(
                    source, size, folder / f"large.{make.__name__.removeprefix('large_').replace('ulog', 'ulg')}"
                )
                rows.append(measure(page, address, process, log, small))
                log.unlink()
    lines = [
        f"The working process may take {options.memory:g} GB (`--memory`).",
        "",
        "| log | GB | sent after, s | answered after, s | server, MB | working process, GB | first picture of another "
        "case meanwhile, s | what the page says |",
        "| --- | --- | --- | --- | --- | --- | --- | --- |",
        *rows,
    ]
    write_result("studio_large_logs", "A log of 2 GB in the studio", "\n".join(lines))


if __name__ == "__main__":
    main()
