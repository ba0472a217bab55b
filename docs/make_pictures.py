"""Draw the pages that docs/ shows: report.png of `alula demo --lockstep`, diagnosis.png of the first tutorial's logs,
studio_STEP.png of each step of the studio on the same logs.

python docs/make_pictures.py [--studio]    # needs chromium; some minutes; the studio's alone
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[1]
PICTURES = Path(__file__).with_name("pictures")
LOGS = (ROOT / "tests/data/px4_sih_flights").glob("drag2_*.ulg.gz")
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


def draw_studio(folder: Path) -> None:
    """Each step of the studio, from the logs to the proof."""
    from playwright.sync_api import expect, sync_playwright

    expect.set_options(timeout=180_000)
    command = [sys.executable, "-m", "alula", "studio", *map(str, sorted((folder / "logs").iterdir()))]
    options = ["--vehicle", "px4_sih", "--cases", str(folder / "cases"), "--port", "0", "--no-browser"]
    process = subprocess.Popen([*command, *options], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    address = process.stdout.readline().split()[-1]
    with sync_playwright() as playwright:
        flags = ["--no-sandbox", "--disable-gpu", "--enable-unsafe-swiftshader"]
        page = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=flags).new_page()
        page.set_viewport_size({"width": 1280, "height": 1000})
        page.set_default_timeout(180_000)
        page.goto(address)

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
    process.terminate()
    process.wait(20)


def main() -> None:
    """Make the pages and draw them."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "logs").mkdir()
        for log in LOGS:
            shutil.copy(log, folder / "logs")
        shutil.copy(VEHICLE, folder / "my_quad.toml")
        draw_studio(folder)
        if "--studio" in sys.argv[1:]:
            return
        alula("diagnose", "logs", "--vehicle", "my_quad.toml", "--html", "diagnosis.html", folder=folder)
        draw(folder / "diagnosis.html", PICTURES / "diagnosis.png", folder)
        alula("demo", "--lockstep", "--out", "demo", folder=folder)
        draw(folder / "demo/report.html", PICTURES / "report.png", folder)


if __name__ == "__main__":
    main()
