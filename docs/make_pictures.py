"""Draw the pages that docs/ shows: report.png of `alula demo`, diagnosis.png of the question that README asks,
studio_STEP.png of each step of the studio on the first tutorial's logs, studio_fleet.png and studio_recording.png of
results.

python -m docs.make_pictures [--studio]    # needs chromium; some minutes; the studio's alone
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from dynamics.vehicle import EffectUse
from fixtures.fleet_flights import write_fleet

if TYPE_CHECKING:
    from playwright.sync_api import Page

ROOT = Path(__file__).parents[1]
PICTURES = Path(__file__).with_name("pictures")
LOGS = (ROOT / "tests/data/px4_sih_flights").glob("drag2_*.ulg.gz")
QUESTION = sorted((ROOT / "tests/data/px4_sih_flights").glob("lag90_*.ulg.gz"))
RECORDING = ROOT / "tests/data/recorded_flight/flight.mcap"
VEHICLE = ROOT / "vehicles/px4_sih.toml"
WIDTH, HEIGHT = 1000, 1150


def alula(*arguments: object, folder: Path) -> None:
    """Run a command; the demo ends with 0, so does a diagnosis."""
    subprocess.run([sys.executable, "-m", "alula", *map(str, arguments)], cwd=folder, check=True)


def draw(page: Path, picture: Path, folder: Path) -> None:
    """The top of a page as chromium shows it, when its scripts have run."""
    options = ["--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", "--virtual-time-budget=20000"]
    size = [f"--window-size={WIDTH},{HEIGHT}", f"--user-data-dir={folder / 'chromium'}"]
    command = ["chromium", *options, *size, f"--screenshot={picture}", page.as_uri()]
    subprocess.run(command, check=True, stderr=subprocess.DEVNULL)


@contextmanager
def studio_page(folder: Path, *arguments: object) -> Iterator[Page]:
    """A browser's page on a studio with its cases in a folder."""
    from playwright.sync_api import expect, sync_playwright

    expect.set_options(timeout=180_000)
    command = [sys.executable, "-m", "alula", "studio", *map(str, arguments), "--cases", str(folder / "cases")]
    process = subprocess.Popen([*command, "--port", "0", "--no-browser"], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    address = process.stdout.readline().split()[-1]
    with sync_playwright() as playwright:
        flags = ["--no-sandbox", "--disable-gpu", "--enable-unsafe-swiftshader"]
        page = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=flags).new_page()
        page.set_viewport_size({"width": 1280, "height": 1000})
        page.set_default_timeout(180_000)
        page.goto(address)
        yield page
    process.terminate()
    process.wait(20)


def draw_results(folder: Path) -> None:
    """A fleet of four vehicles, of which two hide a drag that grows, and a recording."""
    drags = [[EffectUse("rotor_drag", {"coefficient": 2.2e-5 * (1 + 0.1 * week)})] for week in range(8)]
    write_fleet(folder / "fleet", {"v01": [()] * 8, "v02": [()] * 8, "v03": drags, "v04": drags})
    alula("diagnose", "--fleet", "fleet", "--out", "result", folder=folder)
    shutil.copy(RECORDING, folder)
    for name, path in {"fleet": folder / "result", "recording": folder / RECORDING.name}.items():
        with studio_page(folder, "--result", path) as page:
            page.locator(".scatterlayer .trace").first.wait_for()
            page.wait_for_timeout(4000)
            page.screenshot(path=PICTURES / f"studio_{name}.png")


def draw_studio(folder: Path) -> None:
    """Each step of the studio, from the logs to the proof."""
    from playwright.sync_api import expect

    with studio_page(folder, *sorted((folder / "logs").iterdir()), "--vehicle", "px4_sih") as page:

        def shoot(step: str, shown: str, top: str = "") -> None:
            expect(page.locator(f"{shown} .scatterlayer .trace").first).to_be_visible()
            page.wait_for_timeout(4000)
            if top:
                page.locator(top).evaluate("e => window.scrollTo(0, e.getBoundingClientRect().top + scrollY - 70)")
                page.wait_for_timeout(1500)
            page.screenshot(path=PICTURES / f"studio_{step}.png")

        def go(step: str) -> None:
            expect(page.locator(f"#step-{step}")).not_to_have_attribute("data-status", "locked")
            page.locator(f"#step-{step}").click()

        shoot("log", "#log-lines", "#log-flight")
        expect(page.locator("#step-compare")).to_have_attribute("data-status", "done")
        go("check")
        page.wait_for_timeout(4000)
        page.screenshot(path=PICTURES / "studio_check.png")
        go("compare")
        shoot("compare", "#compare-lines", "#compare-log")
        go("diagnose")
        page.get_by_role("button", name="Diagnose", exact=True).click()
        expect(page.locator("#verdict-sentence")).to_be_visible()
        page.wait_for_timeout(4000)
        page.screenshot(path=PICTURES / "studio_verdict.png")
        shoot("diagnose", "#evidence-lines", "#evidence")
        go("add")
        page.get_by_role("button", name=re.compile("^Add ")).click()
        shoot("add", "#falls")
        expect(page.locator("#step-compare")).to_have_attribute("data-status", "done")
        go("prove")
        page.get_by_role("button", name="Compare both versions").click()
        expect(page.locator("#open-loop .scatterlayer .trace").first).to_be_visible()
        page.get_by_role("button", name="Fly it on the mock").click()
        shoot("prove", "#flown-Lemniscate", "#open-loop")


def main() -> None:
    """Make the pages and draw them."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "logs").mkdir()
        for log in LOGS:
            shutil.copy(log, folder / "logs")
        shutil.copy(VEHICLE, folder / "my_quad.toml")
        draw_studio(folder)
        draw_results(folder)
        if "--studio" in sys.argv[1:]:
            return
        for log in QUESTION:
            shutil.copy(log, folder)
        logs = [Path(log).name for log in QUESTION]  # no path of this machine is on the page
        alula("diagnose", *logs, "--vehicle", "px4_sih", "--html", "diagnosis.html", folder=folder)
        draw(folder / "diagnosis.html", PICTURES / "diagnosis.png", folder)
        alula("demo", "--out", "demo", folder=folder)
        draw(folder / "demo/report.html", PICTURES / "report.png", folder)


if __name__ == "__main__":
    main()
