"""Draw the pages that docs/ shows: report.png of `alula demo --lockstep`, diagnosis.png of the first tutorial's logs.

python docs/make_pictures.py            # needs chromium; some minutes
"""

from __future__ import annotations

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


def main() -> None:
    """Make both pages and draw them."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "logs").mkdir()
        for log in LOGS:
            shutil.copy(log, folder / "logs")
        shutil.copy(VEHICLE, folder / "my_quad.toml")
        alula("diagnose", "logs", "--vehicle", "my_quad.toml", "--html", "diagnosis.html", folder=folder)
        draw(folder / "diagnosis.html", PICTURES / "diagnosis.png", folder)
        alula("demo", "--lockstep", "--out", "demo", folder=folder)
        draw(folder / "demo/report.html", PICTURES / "report.png", folder)


if __name__ == "__main__":
    main()
