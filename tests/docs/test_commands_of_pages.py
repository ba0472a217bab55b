"""The commands that pages show are run, a page's in their order, in a folder that holds what the pages name.

README and tutorials are followed by tests of their own. What takes long is shortened (`SHORTER`), words that stand for
a reader's own files are replaced (`STANDS_FOR`), and a command that another page has run is not run again. Whatever is
linked to a vehicle runs on loopback, beside the mock that the page starts.
"""

from __future__ import annotations

import re
import shlex
import shutil
import subprocess
import sys
import urllib.request
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import chain
from pathlib import Path

import pytest

from alula.cli import app
from dynamics.errors import VehicleError
from dynamics.vehicle import Vehicle
from simulation.mock_process import MockProcess, mock_process
from simulation.trial_flight import TrialFlight
from tests.support.command_line import Run, command_line
from tests.support.pages import (
    PAGES,
    TUTORIALS,
    commands_in_blocks,
    commands_in_sentences,
    commands_of_units,
    shell_lines,
)
from tests.support.reader_folder import prepare_reader_folder

SHORTER: Mapping[str, Mapping[str, str]] = {  # options of a command in place of the page's own; "": a flag
    "campaign": {"--flights": "Ellipse_1", "--jobs": "1"},
    "demo": {"--no-learn": "", "--manoeuvre": "hover", "--duration": "5"},  # tests/studies flies it
    "evaluate": {"--no-timing": ""},
    "export": {"--windows": "10", "--no-flight-check": "", "--processor": "native"},  # tests/export has the rest
    "fly": {"--duration": "1", "--height": "0.6", "--processor": "0"},
    "link": {"--window": "1"},
    "sweep": {"--steps": "1", "--seeds": "1", "--jobs": "1"},
    "train": {"--steps": "1", "--ensemble": "1", "--jobs": "1"},
}
STANDS_FOR = {
    "LOG...": "logs",
    "V.toml": "my_quad.toml",
    "MINE.py": "my_effects.py",
    "identify": "identify:duration=10,for=drag",
    "identify:duration=40,box=6x6x4,speed=5": "identify:duration=10,box=6x6x4,speed=5",
    "drag,inertia,lag": "drag",
    "NAME": "rotor_drag",
}
FEWER = {"inertia": "ablation"}  # a study of 4 trainings for one of 50
QUICK = ("alula effects", "alula vehicle show")
NOT_RUN = {  # command as a page has it -> why it is only looked up
    "alula demo --realtime": "tests/studies/test_demo_over_a_link.py flies it",
    "alula train ... --device cuda": "a GPU for each of two processes",
}
ON_A_LINK = ("fly", "link", "mock")
ON_THE_GROUND = {"--no-arm": "", "--timeout": "1"}  # a flight whose pilot does not arm: all but the flying
LANDS = "--vehicle arpl_250g --reference Lemniscate"  # the flight that is flown to its end
MOCKED = {"bundles/my_quad/vehicle.toml": "my_quad.toml"}  # the same vehicle
AT_ONCE, PATIENCE = 3, 120.0  # flights, s
INSTEAD = {  # folders that hold something else on a page
    "diagnosis.md": {"logs": "planted"},
    "first_flight.md": {"recordings": "planted"},
    "identification_flight.md": {"recordings": "planted"},
    "training.md": {"logs": "build/campaign_learning/train"},
}


def commands_of_pages(*, tutorials: bool) -> dict[str, list[str]]:
    """Page to its commands in their order, of the tutorials and README or of all other pages."""
    followed = {"README.md", *(page.name for page in TUTORIALS.glob("*.md"))}
    pages: dict[str, list[str]] = {}
    for page, text in [*commands_in_blocks(), *commands_of_units()]:
        if (page in followed) == tutorials and text not in NOT_RUN:
            pages.setdefault(page, []).append(text)
    return pages


IN_TUTORIALS = commands_of_pages(tutorials=True)
COMMANDS = commands_of_pages(tutorials=False)


def is_linked(text: str) -> bool:
    """Whether a command needs a vehicle, or is one."""
    return words_of(text)[0] in ON_A_LINK


def is_served(text: str) -> bool:
    """Whether a command goes on until it is ended."""
    return words_of(text)[0] == "studio"


def run_key(words: Sequence[str]) -> str:
    """What two commands have in common of which one is run: all but where they write."""
    return shlex.join(sorted(without_options(words, {"--out": "PATH", "--html": "PATH"})))


def words_of(text: str) -> list[str]:
    """The words of a command after `alula`, as they are run."""
    name, *words = shlex.split(text, comments=True)[1:]
    words = [STANDS_FOR.get(word, word).rstrip("/") for word in words]
    if name == "export" and "--verify" in words:
        return [name, *words]
    if name == "sweep":
        words[0] = FEWER.get(words[0], words[0])
    shorter = SHORTER.get(name, {})
    retained = without_options(words, shorter)
    return [name, *retained, *(word for option, value in shorter.items() for word in (option, value) if word)]


def without_options(words: Sequence[str], options: Mapping[str, str]) -> list[str]:
    """Words without some options and their values. options: to a value, empty for a flag."""
    retained: list[str] = []
    skip = False
    for word in words:
        if not skip and word not in options:
            retained.append(word)
        skip = not skip and bool(options.get(word))
    return retained


def option(words: Sequence[str], name: str, default: str = "") -> str:
    """The value of an option."""
    return words[words.index(name) + 1] if name in words else default


def expanded(words: list[str], text: str) -> list[str]:
    """Patterns that a page does not quote, replaced by the files of this folder, as a shell does it."""
    files = {word: sorted(str(path) for path in Path().glob(word)) for word in words if "*" in word}
    is_quoted = {word: f'"{word}"' in text or f"'{word}'" in text for word in files}
    return [file for word in words for file in (files.get(word) if word in files and not is_quoted[word] else [word])]


def make_way(words: Sequence[str]) -> None:
    """Remove what a command is to write, where an earlier command or the reader's folder has it."""
    made = [option(words, "--out")] if "--verify" not in words else []
    if words[0] == "vehicle" and words[1] in ("new", "from-log"):
        made.append(f"{words[2] if words[1] == 'new' else option(words, '--name')}.toml")
    for path in map(Path, filter(None, made)):
        if path.is_dir():
            shutil.rmtree(path)
        path.unlink(missing_ok=True)
        path.with_suffix(".json").unlink(missing_ok=True)


# of a command that several pages show, the one that runs it; a tutorial's are run by the tutorial
RUN_BY = {run_key(words_of(text)): page for page in reversed(COMMANDS) for text in COMMANDS[page]}
RUN_BY |= {run_key(words_of(text)): page for page, texts in IN_TUTORIALS.items() for text in texts}


@pytest.fixture(scope="session")
def reader_folder(arpl_250g: Vehicle, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What every page's folder begins as."""
    return prepare_reader_folder(tmp_path_factory.mktemp("reader") / "folder", arpl_250g)


@pytest.fixture
def here(reader_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A reader's folder, and the present one; a planned flight is tried less than it is."""
    monkeypatch.chdir(shutil.copytree(reader_folder, tmp_path / "here", symlinks=True))
    monkeypatch.setattr("diagnosis.experiment.expectation.TRIALS", (8, 8))
    monkeypatch.setattr("simulation.trial_flight.fly_trial", lambda *_: TrialFlight(0.02, 0.05))
    return Path.cwd()


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    return command_line(monkeypatch, capsys)


def runs_here(text: str) -> bool:
    """Whether a command ends by itself, without a vehicle."""
    return not (is_linked(text) or is_served(text))


@pytest.mark.slow
@pytest.mark.parametrize(
    "page",
    [page for page in COMMANDS if any(map(runs_here, COMMANDS[page]))],
)
def test_the_commands_of_a_page_run(page: str, run: Run, here: Path) -> None:
    for name, replacement in INSTEAD.get(page, {}).items():
        shutil.rmtree(name)
        shutil.copytree(replacement, name)
    for text in COMMANDS[page]:
        if not runs_here(text) or RUN_BY[run_key(words_of(text))] != page:
            continue
        words = expanded(words_of(text), text)
        make_way(words)
        code, shown, wrong = run(*words)
        assert code == 0, f"{text}\nran as: alula {shlex.join(words)}\nended with {code}:\n{shown}\n{wrong}"
        assert "Traceback" not in wrong


@pytest.mark.slow
def test_the_studio_of_a_page_answers_until_it_is_ended(here: Path) -> None:
    for text in (text for texts in COMMANDS.values() for text in texts if is_served(text)):
        command = [sys.executable, "-m", "alula", *words_of(text), "--cases", "cases", "--port", "0", "--no-browser"]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
            assert process.stdout is not None
            address = process.stdout.readline().split()[-1]
            with urllib.request.urlopen(address) as answer:
                assert answer.status == 200, text
            process.terminate()
            rest, _ = process.communicate(timeout=60)  # read: what it prints at its end needs a reader
        assert process.returncode == 0, text
        assert "alula studio --case" in rest, text


@pytest.mark.slow
def test_quick_commands_in_sentences_run(here: Path, run: Run) -> None:
    """Those with all their arguments; the others are looked up by `test_documentation.py`."""
    texts = {text for _, text in commands_in_sentences() if text.startswith(QUICK) or text.endswith(" --help")}
    for text in sorted(texts - {"alula effects", "alula vehicle show", "alula COMMAND --help"}):
        code, shown, wrong = run(*words_of(text))
        assert code == 0, f"{text}\nended with {code}:\n{shown}\n{wrong}"


def mock_of(page: str, words: Sequence[str]) -> tuple[str, list[str]]:
    """Vehicle and other arguments of the mock that a flight or a link check needs: the page's own, if it has one."""
    bundle = option(words, "--bundle")
    vehicle = f"{bundle}/vehicle.toml" if bundle else option(words, "--vehicle", "px4_sih")
    for mock in (words_of(text) for text in COMMANDS[page] if " mock " in text):
        if option(mock, "--vehicle") in (vehicle, MOCKED.get(vehicle)):
            return vehicle, without_options(mock[1:], {"--vehicle": "FILE", "--link": "URL"})
    return vehicle, []


def on_loopback(words: Sequence[str], mock: MockProcess) -> list[str]:
    """A command with the mock's link for its own, and a folder of its own for its recording."""
    folder = ["--record", f"recordings/{mock.port}"] if "--record" in words else []
    return [words[0], "--link", mock.url, *folder, *without_options(words[1:], {"--link": "URL", "--record": "DIR"})]


def fly(page: str, text: str, run: Run) -> str:
    """Run a command that needs a vehicle, beside a mock. Returns what went wrong, empty for nothing."""
    words = words_of(text)
    lands = LANDS in text or words[0] == "link"
    if not lands:
        words = [*without_options(words, ON_THE_GROUND), *filter(None, chain.from_iterable(ON_THE_GROUND.items()))]
    vehicle, arguments = mock_of(page, words)
    with mock_process(*arguments, vehicle=vehicle) as mock:
        code, shown, wrong = run(*on_loopback(words, mock))
    ends_well = code == 0 if lands else code == 4 and "the pilot did not arm" in shown
    return "" if ends_well and "Traceback" not in wrong else f"{page}: {text}\nended with {code}:\n{shown}\n{wrong}"


def run_process(*words: str | Path) -> tuple[int, str, str]:
    """As `command_line`, in a process of its own."""
    command = [sys.executable, "-m", "alula", *map(str, words)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, check=False)
    return done.returncode, done.stdout, done.stderr


def start(page: str, text: str) -> str:
    """Start a mock and end it. Returns what went wrong, empty for nothing."""
    words = words_of(text)
    arguments = without_options(words[1:], {"--vehicle": "FILE", "--link": "URL"})
    try:
        with mock_process(*arguments, vehicle=option(words, "--vehicle")):
            return ""
    except VehicleError as error:
        return f"{page}: {text}\n{error}"


@pytest.mark.slow
@pytest.mark.realtime
def test_whatever_needs_a_vehicle_runs_beside_a_mock(here: Path, run: Run) -> None:
    jobs = {run_key(words_of(text)): (page, text) for page in COMMANDS for text in COMMANDS[page] if is_linked(text)}
    planned = [job for key, job in jobs.items() if "identify" in key]  # here, where plans are tried less
    mocks = [job for job in jobs.values() if " mock " in job[1]]
    flights = [job for job in jobs.values() if job not in planned and job not in mocks]
    with ThreadPoolExecutor(AT_ONCE) as pool:
        outcomes = [pool.submit(fly, *job, run_process) for job in flights]
        outcomes += [pool.submit(start, *job) for job in mocks]
    failures = [outcome.result() for outcome in outcomes] + [fly(*job, run) for job in planned]
    failures = [failure for failure in failures if failure]
    assert not failures, "\n\n".join(failures)


def test_no_command_is_overlooked() -> None:
    """Every line of a block that starts a command of alula is taken for one."""
    names = "|".join(app.COMMANDS)
    start = re.compile(rf"(?:^|[\s/])alula ({names})\b")
    taken = {text for _, text in [*commands_in_blocks(), *commands_of_units()]}
    lines = [line for page in PAGES for line in shell_lines(page) if start.search(line.split("#")[0])]
    assert [line for line in lines if not any(text in line for text in taken)] == []
