"""The studio as a user meets it: how fast it answers, and a log of 2 GB."""

from __future__ import annotations

import gzip
import os
import re
import shutil
import statistics
import struct
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import psutil
from playwright.sync_api import Page as Tab
from playwright.sync_api import expect, sync_playwright

from benchmarks.measurement import ROOT, Page, options_of, paragraph_of
from flights import Flight

DATA = ROOT / "tests" / "data" / "px4_sih_flights"
FLAGS = ("--no-sandbox", "--disable-gpu", "--enable-unsafe-swiftshader", "--disable-background-networking")
PATIENCE = 180_000  # ms
REPEATS = 5
READY = 14.0  # s after a case until a working process waits for the next one
POINTS = "e => JSON.stringify([e.calcdata[0][0].x, e.calcdata[0].length])"
VALUES = "e => String(e.calcdata.map(line => line.reduce((sum, point) => sum + (point.y || 0), 0)))"
WATCH = """(element, key) => {
  const read = READ, before = read(element);
  const begin = (event) => { window.began = event.timeStamp; };
  if (key) document.addEventListener("keydown", begin, { capture: true, once: true });
  window.drawn = new Promise((resolve, reject) => {
    const end = setTimeout(() => reject(new Error("the lines stay as they were")), 60000);
    const look = () => {
      if (read(element) === before) return requestAnimationFrame(look);
      clearTimeout(end);
      requestAnimationFrame(() => resolve(performance.now() - window.began));
    };
    look();
  });
}"""
LENGTHS = {"2 minutes": 120.0, "10 minutes": 600.0}
GOALS = {"2 minutes": 1.0, "10 minutes": 4.0}


def long_log(flight: Flight, seconds: float, path: Path) -> Path:
    """A flight laid end to end until it lasts so long, as Parquet."""
    count = int(np.ceil(seconds * flight.rate / len(flight)))
    rows = round(seconds * flight.rate)
    columns = {name: np.tile(values, count)[:rows] for name, values in flight.columns.items()}
    return Path(replace(flight, time=np.arange(rows) / flight.rate, values=columns).to_parquet(path))


def drop(page: Tab, files: list[Path]) -> float:
    """Seconds from the choice of files to the first line of the first picture."""
    with page.expect_file_chooser() as chosen:
        page.locator("#drop-logs .choose").click()
    began = time.perf_counter()
    chosen.value.set_files([str(path) for path in files])
    expect(page.locator("#log-lines .scatterlayer .trace").first).to_be_visible()
    return time.perf_counter() - began


def new_case(page: Tab, address: str) -> None:
    """An empty case on the first step."""
    page.goto(address)
    page.get_by_role("button", name="New case").click()
    expect(page.get_by_text("No log yet.")).to_be_visible()


def until_drawn(page: Tab, plot: str, read: str, *, act: str | None = None, key: str = "") -> float:
    """Seconds, by the page's own clock, from an act or a key to the frame in which a picture's lines have changed.

    read: expression of the plot. act: a function of the plot, else a key is pressed.
    """
    graph = page.locator(f"#{plot} .js-plotly-plot")
    graph.evaluate(WATCH.replace("READ", read), act is None)
    if act is None:
        page.keyboard.press(key)
    else:
        graph.evaluate(f"element => {{ window.began = performance.now(); ({act})(element); }}")
    return float(page.evaluate("window.drawn")) / 1e3


def zooms(page: Tab, plot: str) -> list[float]:
    """Seconds from a change of the time that is shown to new points of the lines."""
    times = []
    for number in range(REPEATS):
        span = [5.0 + number, 12.0 + 2 * number]
        change = f"element => window.Plotly.relayout(element, {{'xaxis.range': {span}}})"
        times.append(until_drawn(page, plot, POINTS, act=change))
        page.wait_for_timeout(300)
    return times


def sliders(page: Tab) -> list[float]:
    """Seconds from a key on a slider to the new error in words and the new lines, which are drawn last."""
    page.locator(".mantine-Slider-thumb").first.focus()
    times = []
    for _ in range(REPEATS):
        times.append(until_drawn(page, "evidence-lines", VALUES, key="ArrowRight"))
        page.wait_for_timeout(300)
    return times


def memory(process: psutil.Process) -> float:
    """MB of a server and its working processes."""
    return sum(p.memory_info().rss for p in (process, *process.children(recursive=True))) / 1e6


def additions(page: Tab, process: psutil.Process, count: int) -> tuple[list[float], list[float]]:
    """Seconds of each addition from the click to the new version, and MB after each undo."""
    times, levels = [], []
    add = page.get_by_role("button", name=re.compile("^Add "))
    for _ in range(count):
        shutil.rmtree(next(iter(results(page).glob("add-*")), results(page) / "none"), ignore_errors=True)
        began = time.perf_counter()
        add.click()
        expect(page.locator("#step-add")).to_have_attribute("data-status", "done")
        times.append(time.perf_counter() - began)
        expect(page.locator("#step-compare")).to_have_attribute("data-status", "done")
        page.get_by_role("button", name="Undo").click()
        expect(page.locator("#step-add")).to_have_attribute("data-status", "open")
        expect(add).to_be_enabled()
        levels.append(memory(process))
    return times, levels


def results(page: Tab) -> Path:
    """The folder of the case's results."""
    return Path(page.locator("#command").inner_text().split("/logs/")[0].split()[-1]) / "results"


def journey(page: Tab, address: str, logs: list[Path]) -> None:
    """From the logs to the diagnosis."""
    new_case(page, address)
    drop(page, logs)
    page.get_by_role("textbox", name="A bundled vehicle").click()
    page.get_by_role("option", name="px4_sih").click()
    page.get_by_role("button", name="Use it").click()
    expect(page.locator("#step-compare")).to_have_attribute("data-status", "done")


def measure(page: Tab, address: str, process: psutil.Process, folder: Path, count: int) -> str:
    """All measurements as a page of Markdown."""
    logs = []
    for name in ("drag2_1_circle", "drag2_4_lemniscate"):
        logs.append(folder / f"{name}.ulg")
        logs[-1].write_bytes(gzip.decompress((DATA / f"{name}.ulg.gz").read_bytes()))
    flight = Flight.read(logs[0])
    lines = ["| | median | goal |", "| --- | --- | --- |"]
    for label, seconds in LENGTHS.items():
        path = long_log(flight, seconds, folder / f"{label.replace(' ', '_')}.parquet")
        times = []
        for _ in range(3):
            time.sleep(READY)
            new_case(page, address)
            times.append(drop(page, [path]))
        lines.append(f"| first picture, {label} at {flight.rate:.0f} Hz | {_median(times, 's')} | {GOALS[label]:g} s |")
        page.wait_for_timeout(500)
        lines.append(f"| zoom of that picture, {label} | {_median(zooms(page, 'log-lines'), 'ms')} | 150 ms |")
    journey(page, address, logs)
    page.locator("#step-compare").click()
    expect(page.locator("#compare-lines .scatterlayer .trace").first).to_be_visible()
    page.wait_for_timeout(1000)
    lines.append(f"| zoom of the linked panels | {_median(zooms(page, 'compare-lines'), 'ms')} | 150 ms |")
    page.locator("#step-diagnose").click()
    began = time.perf_counter()
    page.get_by_role("button", name="Diagnose", exact=True).click()
    expect(page.locator("#verdict-sentence")).to_be_visible()
    lines.append(f"| diagnosis of two flights, 103 s | {time.perf_counter() - began:.1f} s | |")
    expect(page.locator("#evidence-lines .scatterlayer .trace").first).to_be_visible()
    page.wait_for_timeout(1000)
    lines.append(f"| slider, to the new error and lines | {_median(sliders(page), 'ms')} | 100 ms |")
    page.locator("#step-add").click()
    times, levels = additions(page, process, count)
    lines.append(f"| addition, to the fallen error | {_median(times, 's')} | 5 s |")
    tenth = max(1, count // 10)
    early, late = statistics.mean(levels[tenth : 2 * tenth] or levels), statistics.mean(levels[-tenth:])
    lines.append(
        f"| memory after {2 * tenth} and after {count} additions and undos | {early:.0f}; {late:.0f} MB | flat |"
    )
    return "\n".join(lines)


def _median(times: list[float], unit: str) -> str:
    factor = 1e3 if unit == "ms" else 1.0
    digits = 0 if unit == "ms" else 2
    spread = f"{factor * min(times):.{digits}f} to {factor * max(times):.{digits}f}"
    return f"{factor * statistics.median(times):.{digits}f} {unit} ({spread} of {len(times)})"


@contextmanager
def studio_in_browser(folder: Path, *options: str) -> Iterator[tuple[Tab, str, psutil.Process]]:
    """A studio with its cases in a folder, and a browser: a page, the studio's address, its process."""
    browser = next(p for name in ("chromium", "chromium-browser", "google-chrome") if (p := shutil.which(name)))
    command = [sys.executable, "-m", "alula", "studio", "--cases", str(folder / "cases"), "--port", "0", *options]
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    with sync_playwright() as playwright:
        process = subprocess.Popen([*command, "--no-browser"], stdout=subprocess.PIPE, text=True, env=environment)
        try:
            assert process.stdout is not None
            address = process.stdout.readline().split()[-1]
            page = playwright.chromium.launch(executable_path=browser, args=list(FLAGS)).new_page()
            page.set_default_timeout(PATIENCE)
            expect.set_options(timeout=PATIENCE)
            yield page, address, psutil.Process(process.pid)
        finally:
            process.terminate()
            process.wait(20)


def speed(words: Sequence[str]) -> Page:
    """How fast the studio answers: first picture, zoom, slider, addition, and its memory over fifty additions.

        python -m benchmarks studio speed [--additions 50]

    Times are a user's: from the choice of a file, or the key, to the picture in a browser (headless Chromium, software
    rendering, on the same machine; zoom and slider by the page's own clock), with a working process that waits, as some
    seconds after the start and after each new case. Long logs are flights of real PX4 laid end to end, which only the
    drawing looks at.
    """
    parser = options_of(speed.__doc__)
    parser.add_argument("--additions", type=int, default=50)
    count = parser.parse_args(words).additions
    with tempfile.TemporaryDirectory() as name, studio_in_browser(Path(name)) as (page, address, process):
        body = measure(page, address, process, Path(name), count)
    return Page("studio", "How fast the studio answers", f"{paragraph_of(speed.__doc__, 2)}\n\n{body}")


SOURCE = "drag2_4_lemniscate"
HEADER, DATA_MESSAGE, SUBSCRIPTION = 16, ord("D"), ord("A")  # of a ULog: bytes, kinds of messages
PERIOD = 0.05  # s between two looks at the memory
LARGE_LOGS_PATIENCE = 1_200.0  # s


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


def answer(page: Tab) -> str:
    """Text of the page about the log in the end."""
    began = time.monotonic()
    while time.monotonic() - began < LARGE_LOGS_PATIENCE:
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


def large_logs_measure(page: Tab, address: str, process: psutil.Process, log: Path, small: Path) -> str:
    """A row of the table: the upload, the answer, and another case meanwhile."""
    new_case(page, address)
    with Peak(process) as peak:
        began = time.perf_counter()
        with page.expect_file_chooser() as chosen:
            page.locator("#drop-logs .choose").click()
        chosen.value.set_files([str(log)])
        expect(page.locator("#drop-logs .answer")).to_have_text("1 file received", timeout=1e3 * LARGE_LOGS_PATIENCE)
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


def large_logs(words: Sequence[str]) -> Page:
    """Studio with a log of 2 GB: memory of the server and of the working process, and what the page says.

        python -m benchmarks studio large_logs [--size 2.0] [--memory 4.0]

    A ULog of PX4 and a CSV of Alula's, laid end to end until they are so large, are dropped on the page in headless
    Chromium. While each is read another case takes a log of usual size. Memory is the largest that was seen, twenty
    times a second.
    """
    parser = options_of(large_logs.__doc__)
    parser.add_argument("--size", type=float, default=2.0, help="of a log, GB")
    parser.add_argument("--memory", type=float, default=4.0, help="that a working process may take, GB")
    options = parser.parse_args(words)
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
                rows.append(large_logs_measure(page, address, process, log, small))
                log.unlink()
    lines = [
        f"The working process may take {options.memory:g} GB (`--memory`).",
        "",
        "| log | GB | sent after, s | answered after, s | server, MB | working process, GB | first picture of another "
        "case meanwhile, s | what the page says |",
        "| --- | --- | --- | --- | --- | --- | --- | --- |",
        *rows,
    ]
    return Page("studio_large_logs", "A log of 2 GB in the studio", "\n".join(lines))
