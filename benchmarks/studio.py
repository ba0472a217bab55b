"""How fast the studio answers: first picture, zoom, slider, addition, and its memory over fifty additions.

    python -m benchmarks.studio [--additions 50]

Times are a user's: from the choice of a file, or the key, to the picture in a browser (headless Chromium, software
rendering, on the same machine; zoom and slider by the page's own clock), with a working process that waits, as some
seconds after the start and after each new case. Long logs are flights of real PX4 laid end to end, which only the
drawing looks at.
"""

from __future__ import annotations

import argparse
import gzip
import os
import re
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import psutil
from playwright.sync_api import Page, expect, sync_playwright

from benchmarks.provenance import write_result
from flights import Flight

DATA = Path(__file__).parents[1] / "tests" / "data" / "px4_sih_flights"
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


def drop(page: Page, files: list[Path]) -> float:
    """Seconds from the choice of files to the first line of the first picture."""
    with page.expect_file_chooser() as chosen:
        page.locator("#drop-logs .choose").click()
    began = time.perf_counter()
    chosen.value.set_files([str(path) for path in files])
    expect(page.locator("#log-lines .scatterlayer .trace").first).to_be_visible()
    return time.perf_counter() - began


def new_case(page: Page, address: str) -> None:
    """An empty case on the first step."""
    page.goto(address)
    page.get_by_role("button", name="New case").click()
    expect(page.get_by_text("No log yet.")).to_be_visible()


def until_drawn(page: Page, plot: str, read: str, *, act: str | None = None, key: str = "") -> float:
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


def zooms(page: Page, plot: str) -> list[float]:
    """Seconds from a change of the time that is shown to new points of the lines."""
    times = []
    for number in range(REPEATS):
        span = [5.0 + number, 12.0 + 2 * number]
        change = f"element => window.Plotly.relayout(element, {{'xaxis.range': {span}}})"
        times.append(until_drawn(page, plot, POINTS, act=change))
        page.wait_for_timeout(300)
    return times


def sliders(page: Page) -> list[float]:
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


def additions(page: Page, process: psutil.Process, count: int) -> tuple[list[float], list[float]]:
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


def results(page: Page) -> Path:
    """The folder of the case's results."""
    return Path(page.locator("#command").inner_text().split("/logs/")[0].split()[-1]) / "results"


def journey(page: Page, address: str, logs: list[Path]) -> None:
    """From the logs to the diagnosis."""
    new_case(page, address)
    drop(page, logs)
    page.get_by_role("textbox", name="A bundled vehicle").click()
    page.get_by_role("option", name="px4_sih").click()
    page.get_by_role("button", name="Use it").click()
    expect(page.locator("#step-compare")).to_have_attribute("data-status", "done")


def measure(page: Page, address: str, process: psutil.Process, folder: Path, count: int) -> str:
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
def studio_in_browser(folder: Path, *options: str) -> Iterator[tuple[Page, str, psutil.Process]]:
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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--additions", type=int, default=50)
    count = parser.parse_args().additions
    with tempfile.TemporaryDirectory() as name, studio_in_browser(Path(name)) as (page, address, process):
        body = measure(page, address, process, Path(name), count)
    write_result("studio", "How fast the studio answers", f"{(__doc__ or '').split(chr(10) * 2)[2]}\n\n{body}")


if __name__ == "__main__":
    main()
