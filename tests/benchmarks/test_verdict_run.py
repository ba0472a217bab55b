"""Runs of the judge: answers stay, a run that was stopped goes on, and what is not there is left out with a word."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.verdict import __main__ as command
from benchmarks.verdict import run as runs
from benchmarks.verdict.asking import ask
from benchmarks.verdict.cases import Case, planned, read_sets
from benchmarks.verdict.posing import RECORDINGS
from benchmarks.verdict.record import Record
from benchmarks.verdict.run import Run, answer, finished, read_run, write_run
from benchmarks.verdict.scoring import Answer, Expected, Outcome, outcome_of
from benchmarks.verdict.table import page, table
from dynamics.errors import RequestError
from tests.support.judged_cases import JUDGED, KILLED_SEED, NAMED, named_drag

SETS = read_sets()


@pytest.fixture
def case_log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The cases that were asked, a line each; nothing is flown."""
    file = tmp_path / "questions"
    file.touch()
    monkeypatch.setenv(JUDGED, str(file))
    monkeypatch.setattr(runs, "ask", named_drag)
    monkeypatch.chdir(tmp_path)
    return file


def begun(folder: Path, first: int) -> tuple[Run, list[Case]]:
    """A run of three cases, whose seeds rise from the first."""
    run = Run.begun(("short",), first, 3)
    write_run(run, folder)
    cases = [Case("short", SETS["short"].cases[0], first + i) for i in range(3)]
    return run, cases


def test_a_run_that_was_stopped_goes_on_with_what_is_absent(tmp_path: Path, case_log: Path) -> None:
    folder = tmp_path / "run"
    run, cases = begun(folder, 10)

    def stop_after_one(_: Record) -> None:
        if len(finished(cases, folder)) == 1:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        answer(cases, run, folder, processes=1, note=stop_after_one)
    done = set(finished(cases, folder))
    assert len(done) == 1
    case_log.write_text("")
    records = answer(cases, read_run(folder), folder, processes=2, note=lambda _: None)
    assert [record.key for record in records] == [case.key for case in cases]
    assert set(case_log.read_text().split()) == {case.key for case in cases} - done
    assert not list(folder.glob("*.part"))


def test_a_process_that_is_killed_is_an_answer_and_the_others_are_asked(tmp_path: Path, case_log: Path) -> None:
    run, cases = begun(tmp_path / "run", KILLED_SEED - 1)
    records = answer(cases, run, tmp_path / "run", processes=1, note=lambda _: None)
    outcomes = [outcome_of(record.answer, record.expected) for record in records]
    assert outcomes == [Outcome.RIGHT, Outcome.WRONG, Outcome.RIGHT]
    assert "killed" in records[1].answer.error


def test_answers_of_two_versions_are_never_mixed(
    tmp_path: Path, case_log: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "run"
    run, cases = begun(folder, 10)
    answer(cases[:1], run, folder, processes=1, note=lambda _: None)
    monkeypatch.setattr(runs, "code", lambda: "another")
    assert len(answer(cases[:1], run, folder, processes=1, note=lambda _: None)) == 1  # scored once more
    with pytest.raises(RequestError, match="the code has changed since"):
        answer(cases, run, folder, processes=1, note=lambda _: None)


def test_the_code_of_a_run_is_that_of_the_rooms(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runs, "ROOT", tmp_path)
    (tmp_path / "diagnosis").mkdir()
    (tmp_path / "docs").mkdir()
    before = runs.code()
    (tmp_path / "docs" / "page.py").write_text("")
    assert runs.code() == before
    (tmp_path / "diagnosis" / "search.py").write_text("LIMIT = 1")
    assert runs.code() != before


def test_a_folder_has_one_run(tmp_path: Path) -> None:
    begun(tmp_path / "run", 1)
    with pytest.raises(RequestError, match="holds a run already"):
        begun(tmp_path / "run", 1)
    with pytest.raises(RequestError, match="holds no run"):
        read_run(tmp_path)


def test_the_command_stops_with_a_hint_and_goes_on(
    tmp_path: Path, case_log: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(command, "answer", interrupted)
        assert command.main(["--sets", "short", "--seeds", "50", "--limit", "2"]) == 130
    (folder,) = (tmp_path / "build" / "verdict").iterdir()
    assert f"0 of 2 are answered. Go on with --resume {folder.relative_to(tmp_path)}" in capsys.readouterr().err
    assert command.main(["--resume", str(folder), "--processes", "1"]) == 0
    printed = capsys.readouterr().out
    assert "| one log of 22 s | 2 | 2 | 0 | 0 | 0 | 0 | 2 of 2 | 2 of 2 (100 %) | 2.0, 2, 4 |" in printed


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--sets", "tall"], "no such set"),
        (["--limit", "0"], "wanted 1 or more"),
        (["--resume", "there"], "holds no run"),
        (["--resume", "there", "--limit", "3"], "Leave these options out"),
    ],
    ids=["set", "limit", "folder", "options"],
)
def test_a_wrong_request_is_refused(
    arguments: list[str],
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert command.main(arguments) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "build").exists()


def test_recordings_that_are_not_there_are_left_out_with_a_sentence(
    tmp_path: Path, case_log: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delenv(RECORDINGS, raising=False)
    assert command.main(["--sets", "rotorpy"]) == 0
    assert "3 cases of rotorpy are left out: no folder of recordings is named" in capsys.readouterr().out
    monkeypatch.setenv(RECORDINGS, "")
    assert command.main(["--sets", "px4_real", "--limit", "2", "--recordings", str(tmp_path)]) == 0
    assert f"2 cases of px4_real are left out: their logs are not in {tmp_path}" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("set_name", "entry", "outcome"),
    [
        ("real", "motors at 10 Hz", Outcome.RIGHT),
        ("real", "hover, tape, E8", Outcome.RIGHT),
        ("real", "hover, cut propeller, E8", Outcome.DECLARED),
        ("mutated", "few", Outcome.RIGHT),
    ],
)
def test_an_answer_of_the_product_is_scored(set_name: str, entry: str, outcome: Outcome) -> None:
    (case,) = [case for case in planned(SETS, [set_name], 1, None) if case.entry.name == entry][:1]
    record = ask(case)
    assert outcome_of(record.answer, record.expected) is outcome, record.answer
    assert record.took > 0


def test_an_error_within_the_product_is_an_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object, **__: object) -> None:
        raise ZeroDivisionError("shapes")

    monkeypatch.setattr("benchmarks.verdict.asking.alula.diagnose", fail)
    (case,) = [case for case in planned(SETS, ["real"], 1, None) if case.entry.name == "motors at 10 Hz"]
    record = ask(case)
    assert record.answer.error.startswith("ZeroDivisionError: shapes")
    assert outcome_of(record.answer, record.expected) is Outcome.WRONG


def test_the_page_lists_what_fell_short_the_worst_first() -> None:
    inertia = {**NAMED, "name": "inertia"}
    answers = [Answer(refusal="too short"), Answer({"verdict": "effect", "effects": [inertia]}), Answer(error="crash")]
    records = [
        Record(f"case-{i}", "captured", i, Expected({"mass": {"ratio": 1.2}}, ("mass",)), each, 1.0)
        for i, each in enumerate(answers)
    ]
    lost = Record("case-9", "captured", 9, Expected(), Answer(), 0.0, lost=True)
    text = page([*records, lost], SETS, "Commit abc.")
    listed = [text.index(word) for word in ("- **sure and wrong**", "- **wrong**", "- **silent**")]
    assert listed == sorted(listed)
    assert "did not keep its path: case-9" in text
    assert "| 3 | 0 | 0 | 1 | 1 | 1 | 0 of 3 | - |" in table([*records, lost], SETS)
