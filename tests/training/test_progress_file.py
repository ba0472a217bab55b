"""The course of a training on disk."""

from __future__ import annotations

from pathlib import Path

import pytest

from dynamics.errors import RequestError
from training.progress_file import append, begin, progress_file, read_course
from training.reports import Report


def report_of(member: int, step: int) -> Report:
    return Report(member, step, 300, 0.5, None, 0.4, 0.4, 1e-3)


def test_a_course_is_read_while_it_is_written(tmp_path: Path) -> None:
    path = progress_file(tmp_path / "pi_tcn.pt")
    begin(path, 2, "alula train", resume=False)
    append(path, report_of(0, 100))
    append(path, report_of(1, 100))
    with path.open("ab") as file:
        file.write(b'{"member": 0, "st')  # torn
    course = read_course(path)
    assert path.name == "pi_tcn.progress.jsonl"
    assert course.beginning.members == 2
    assert course.reports == (report_of(0, 100), report_of(1, 100))


def test_a_resumed_training_keeps_its_lines_and_another_one_does_not(tmp_path: Path) -> None:
    path = tmp_path / "m.progress.jsonl"
    begin(path, 1, "alula train", resume=False)
    append(path, report_of(0, 100))
    begin(path, 1, "alula train --resume", resume=True)
    append(path, report_of(0, 100))  # evaluated again after it was killed
    assert read_course(path).reports == (report_of(0, 100),)
    begin(path, 1, "alula train --overwrite", resume=False)
    assert read_course(path).reports == ()


def test_what_is_no_course_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "m.progress.jsonl"
    with pytest.raises(RequestError, match="Give a model"):
        read_course(path)
    path.write_text('{"some": "thing"}\n')
    with pytest.raises(RequestError, match="no course"):
        read_course(path)
    with pytest.raises(RequestError, match="--resume"):
        begin(tmp_path / "none" / "m.progress.jsonl", 1, "alula train", resume=False)
