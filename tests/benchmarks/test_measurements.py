"""Measurements have one command; each has its help, its smallest form is quick, and its page says how it was made."""

import argparse
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from benchmarks import __main__ as command
from benchmarks import measurement, provenance
from benchmarks.catalogue import SCRIPTS, THEMES, Measurement, measured_code
from tests.support.pages import ROOT

ALL = [(theme, name) for theme, names in THEMES.items() for name in names]
UNDER_TWO_SECONDS = [
    ("link", "clock"),
    ("link", "recorder"),
    ("simulator", "speed"),
    ("readers", "reading"),
]

HEAD = re.compile(
    r"# .+\n\n\d{4}-\d\d-\d\d, commit (?:[0-9a-f]{7,40}(?: and uncommitted changes)?|unknown \(no git\)), .+, "
    r"\d+ cores, load .+ Command: `python .+`\n\n"
)


@pytest.fixture
def results(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder in the place of benchmarks/results."""
    monkeypatch.setattr(provenance, "RESULTS", tmp_path)
    return tmp_path


@pytest.fixture
def commit_unasked() -> Iterator[None]:
    """The commit is asked for anew."""
    provenance.commit.cache_clear()
    yield
    provenance.commit.cache_clear()


@pytest.mark.parametrize(("theme", "name"), ALL, ids=[f"{theme}-{name}" for theme, name in ALL])
def test_help_names_the_command(theme: str, name: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        command.function_of(THEMES[theme][name])(["--help"])
    assert ended.value.code == 0
    text = capsys.readouterr().out
    assert f"python -m benchmarks {theme} {name}" in text
    assert "--quick" in text


@pytest.mark.parametrize(("theme", "name"), UNDER_TWO_SECONDS)
def test_a_page_is_headed_by_how_it_was_made(theme: str, name: str, results: Path) -> None:
    chosen = THEMES[theme][name]
    command.take(chosen, chosen.quick)
    page = results / f"{chosen.pages[0]}.md"
    assert list(results.iterdir()) == [page]
    text = page.read_text(encoding="utf-8")
    assert HEAD.match(text)
    assert "|" in HEAD.sub("", text)


def test_the_smallest_form_writes_nothing(results: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command.take(THEMES["link"]["clock"], ["--quick"])
    assert list(results.iterdir()) == []
    assert HEAD.search(capsys.readouterr().out)


def test_every_page_of_results_is_a_measurements() -> None:
    results = (ROOT / "benchmarks" / "results").glob("*.md")
    pages = {page.stem for page in results if "**History.**" not in page.read_text(encoding="utf-8")}
    assert pages - set(measured_code()) == set()


@pytest.mark.parametrize("code", sorted({path for paths in measured_code().values() for path in paths}))
def test_what_a_page_measures_is_there(code: str) -> None:
    assert (ROOT / code).exists()


def test_no_script_is_in_no_catalogue() -> None:
    scripts = {
        path.stem
        for path in (ROOT / "benchmarks").glob("*.py")
        if "\ndef main() -> None:" in path.read_text(encoding="utf-8") and path.stem != "__main__"
    }
    assert scripts - set(SCRIPTS) == set()


@pytest.mark.parametrize(
    ("words", "names"), [(["nothing"], "adaptation, rotor_loss"), (["link", "nothing"], "flood, parsing")]
)
def test_a_name_that_is_none_is_answered_by_those_that_are(
    words: list[str], names: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert command.main(words) == command.REQUEST
    assert names in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "taken"),
    [
        (["link", "flood", "--seconds", "1"], ("link", "flood", ["--seconds", "1"])),
        (["fleet", "--logs", "20"], ("fleet", "fleet", ["--logs", "20"])),
        (["fleet", "fleet"], ("fleet", "fleet", [])),
        (["public_sets", "folder"], ("public_sets", "score", ["folder"])),
    ],
)
def test_a_theme_of_one_measurement_needs_no_second_name(
    words: list[str], taken: tuple[str, str, list[str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: list[tuple[Measurement, list[str]]] = []
    monkeypatch.setattr(command, "take", lambda chosen, options: calls.append((chosen, options)))
    assert command.main(words) == 0
    theme, name, options = taken
    assert calls == [(THEMES[theme][name], options)]


def test_help_of_a_theme_lists_its_measurements(capsys: pytest.CaptureFixture[str]) -> None:
    assert command.main(["link", "--help"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[:2] for line in lines] == [["link", name] for name in THEMES["link"]]


def test_all_go_on_after_a_failure(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    outcome = {"speed": 1, "load": 0, "lockstep": 3}
    monkeypatch.setattr(
        command, "own_command", lambda _, name, *words: [sys.executable, "-c", f"raise SystemExit({outcome[name]})"]
    )
    assert command.main(["simulator"]) == 1
    assert capsys.readouterr().err.strip() == "failed: simulator speed, simulator lockstep"


@pytest.mark.skipif(shutil.which("make") is None, reason="needs make")
@pytest.mark.parametrize(
    ("target", "line"),
    [
        ("benchmarks/link/flood.py", "-m benchmarks link flood"),
        ("benchmarks/link.py", "-m benchmarks link"),
        ("benchmarks/studio.py", "-m benchmarks studio"),
        ("study", "-m benchmarks all"),
    ],
)
def test_make_takes_a_theme_or_a_measurement(target: str, line: str) -> None:
    made = subprocess.run(["make", "-n", target], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    assert any(text.endswith(line) for text in made.splitlines())


def test_finished_cases_are_not_measured_again(tmp_path: Path) -> None:
    options = argparse.Namespace(kept=tmp_path / "build" / "cases.jsonl", jobs=1, cases=None)
    taken: list[int] = []

    def measure(case: int) -> dict[str, int]:
        taken.append(case)
        return {"key": case, "square": case**2}

    def squares(count: int) -> list[int]:
        results = measurement.measured(measure, range(count), options, str, key_of=int)
        return [result["square"] for result in results]

    assert squares(2) == [0, 1]
    assert squares(4) == [0, 1, 4, 9]
    assert taken == [0, 1, 2, 3]
    options.cases = 1
    assert squares(4) == [0]


def test_a_number_keeps_the_kind_of_its_default() -> None:
    chosen = measurement.options_of("A measurement.", seconds=2.0, first_seed=5).parse_args(
        ["--seconds", "1", "--first-seed", "7"]
    )
    assert (chosen.seconds, chosen.first_seed) == (1.0, 7)
    assert isinstance(chosen.first_seed, int)
    assert isinstance(chosen.seconds, float)


def test_a_later_option_wins_over_the_smallest_form(capsys: pytest.CaptureFixture[str]) -> None:
    command.take(THEMES["link"]["clock"], ["--quick", "--seeds", "2"])
    assert "of 2 |" in capsys.readouterr().out


def test_the_head_says_so_without_git(commit_unasked: None, monkeypatch: pytest.MonkeyPatch) -> None:
    def without_git(*_: object, **__: object) -> None:
        raise FileNotFoundError("git")

    monkeypatch.setattr(provenance.subprocess, "run", without_git)
    assert ", commit unknown (no git), " in provenance.provenance()


def test_a_measurement_names_its_code() -> None:
    without = [m for names in THEMES.values() for m in names.values() if not m.of or not m.pages]
    assert without == []
    assert all(isinstance(m, Measurement) for names in THEMES.values() for m in names.values())
