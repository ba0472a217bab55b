"""`alula inspect` as a user meets it: table, JSON, page, exit codes."""

from __future__ import annotations

import gzip
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import msgspec
import pytest

from alula.cli import app
from flights import Flight
from flights.quality import Inspection
from tests.support.simulated_flight import flown, table


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return table(flown().log).to_csv(tmp_path_factory.mktemp("logs") / "good.csv")


@pytest.fixture(scope="module")
def poor(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """No motors at all."""
    path = tmp_path_factory.mktemp("logs") / "poor.parquet"
    flight = Flight.from_log(flown().log, rate=100.0)
    slow = {name: values for name, values in flight.columns.items() if not name.startswith(("rotor", "thrust"))}
    return Flight(flight.time, slow, flight.provenance).to_parquet(path)


class Finished(NamedTuple):
    code: int
    out: str
    err: str


Inspect = Callable[..., Finished]


@pytest.fixture
def inspect(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Inspect:
    """Run `alula inspect` in this process."""

    def run(*arguments: object) -> Finished:
        monkeypatch.setattr(sys, "argv", ["alula", "inspect", *map(str, arguments)])
        with pytest.raises(SystemExit) as caught:
            app.main()
        return Finished(int(caught.value.code or 0), *capsys.readouterr())

    return run


def test_a_good_log_ends_with_0_and_lists_what_it_can_identify(inspect: Inspect, good: Path) -> None:
    done = inspect(good)
    assert done.code == 0
    assert "This log is good" in done.out
    assert re.search(r"rotor_drag\s+│ yes", done.out)


def test_a_log_that_cannot_answer_ends_with_3_and_the_reason(inspect: Inspect, poor: Path) -> None:
    done = inspect(poor)
    assert done.code == 3
    assert "This log is unusable" in done.out
    assert "neither rotor speeds nor commands" in done.err
    assert "Traceback" not in done.err


@pytest.mark.parametrize(("name", "code", "flown_for"), [("refused_lying_61deg", 3, 0.0), ("tipped_140deg", 0, 10.2)])
def test_lying_on_the_ground_with_motors_on_is_no_flight(
    inspect: Inspect, name: str, code: int, flown_for: float
) -> None:
    """Real PX4, which flew for 0 s and for 10.0 s; ground was once counted as flight."""
    done = inspect(Path("tests/data/px4_sih_flights") / f"{name}.ulg.gz", "--json")
    (inspection,) = msgspec.json.decode(done.out, type=list[Inspection])
    assert done.code == code
    assert inspection.free_flight == pytest.approx(flown_for, abs=0.3)
    assert ("no_flight" in {finding.name for finding in inspection.findings}) == (code == 3)


def test_a_wrong_unit_is_refused_and_repair_writes_the_file_that_reads_it(inspect: Inspect, tmp_path: Path) -> None:
    real = Flight.read(Path("tests/data/nanobench/B3_figure8_fast_rep1.csv.gz"))
    in_mm = real.columns | {f"position_{axis}": 1000 * real[f"position_{axis}"] for axis in "xyz"}
    path, repairs = Flight(real.time, in_mm, real.provenance).to_csv(tmp_path / "mm.csv"), tmp_path / "repairs.toml"
    refused = inspect(path)
    assert refused.code == 3
    assert 'repairs = [{quantity = "position", scale = 0.001}]' in refused.err
    repaired = inspect(path, "--repair", repairs)
    assert repaired.code == 0
    assert f"written: {repairs}" in repaired.err
    assert inspect(path, "--mapping", repairs).out == repaired.out
    assert inspect(path, "--repair", repairs).code == 2  # it is not written over
    unneeded = tmp_path / "unneeded.toml"
    assert "nothing to repair" in inspect(path, "--mapping", repairs, "--repair", unneeded).err
    assert not unneeded.exists()


def test_a_cut_log_is_said_to_be_cut(inspect: Inspect, good: Path, tmp_path: Path) -> None:
    packed = gzip.compress(good.read_bytes())
    path = tmp_path / "cut.csv.gz"
    path.write_bytes(packed[: len(packed) * 3 // 4])
    assert "damaged: the gzip file ends early" in inspect(path).out


def test_json_is_a_list_of_verdicts_even_when_one_cannot_answer(inspect: Inspect, good: Path, poor: Path) -> None:
    done = inspect(good, poor, "--json")
    assert done.code == 3
    first, second = msgspec.json.decode(done.out, type=list[Inspection])
    assert (first.verdict, second.verdict) == ("good", "unusable")
    assert first.delays
    assert {effect.answer for effect in first.effects} <= {"yes", "weakly", "no"}


@pytest.mark.parametrize(("content", "code"), [(None, 2), ("", 3), ("nonsense", 2)])
def test_a_file_that_is_no_log_is_refused_by_name(
    inspect: Inspect, tmp_path: Path, content: str | None, code: int
) -> None:
    path = tmp_path / "log.csv"
    if content is not None:
        path.write_text(content)
    done = inspect(path)
    assert done.code == code
    assert "log.csv" in done.err
    assert "Traceback" not in done.err


def test_a_good_log_beside_a_broken_one_is_still_inspected(inspect: Inspect, good: Path, tmp_path: Path) -> None:
    done = inspect(good, tmp_path / "missing.ulg")
    assert done.code == 2
    assert "This log is good" in done.out
    assert "1 of 2 logs could not be read" in done.err


def test_the_page_holds_everything_it_needs(inspect: Inspect, good: Path, poor: Path, tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    inspect(good, poor, "--html", page)
    text = page.read_text(encoding="utf-8")
    assert not re.search(r"<(script|link|img)[^>]+(src|href)\s*=\s*[\"']?https?:", text)
    assert text.count('class="verdict') == 2
    assert "rotor_gyroscopic" in text


def test_a_page_that_cannot_be_written_is_a_wrong_request(inspect: Inspect, good: Path, tmp_path: Path) -> None:
    done = inspect(good, "--html", tmp_path / "no_folder" / "page.html")
    assert done.code == 2
    assert "cannot write" in done.err


BROWSER = next(
    (path for name in ("chromium", "chromium-browser", "google-chrome") if (path := shutil.which(name))), None
)


@pytest.mark.skipif(BROWSER is None and os.environ.get("CI") != "true", reason="no Chromium here; CI has one")
def test_the_page_draws_its_plots_in_a_browser_without_a_network(inspect: Inspect, good: Path, tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    inspect(good, "--html", page)
    assert BROWSER is not None, "CI must have Chromium"
    command = [
        BROWSER,
        "--headless",
        "--no-sandbox",
        "--disable-gpu",
        "--use-gl=swiftshader",
        "--enable-unsafe-swiftshader",
        "--proxy-server=127.0.0.1:9",
        f"--user-data-dir={tmp_path / 'profile'}",
        "--virtual-time-budget=5000",
        "--dump-dom",
        page.as_uri(),
    ]
    done = subprocess.run(command, capture_output=True, text=True, timeout=250, check=True)
    assert done.stdout.count('class="main-svg"') >= 3
    assert "late" in done.stdout
