"""Files appear whole or not at all."""

from __future__ import annotations

from pathlib import Path

import pytest

from dynamics import files
from dynamics.errors import RequestError
from dynamics.files import write_whole


def test_a_full_disk_leaves_the_old_file_and_no_torn_one(tmp_path: Path) -> None:
    path = tmp_path / "page.html"
    assert write_whole(path, lambda part: part.write_text("old"), advice="Give another.") == path

    def fill(part: Path) -> None:
        part.write_text("n")
        Path("/dev/full").write_text("ew")

    with pytest.raises(RequestError, match=r"cannot write .*page.html: No space left on device. Give another."):
        write_whole(path, fill, advice="Give another.")
    assert [(file.name, file.read_text()) for file in tmp_path.iterdir()] == [("page.html", "old")]


def test_a_folder_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(RequestError, match=r"cannot write .*: No such file or directory. Make it."):
        write_whole(tmp_path / "none" / "x", lambda part: part.write_text(""), advice="Make it.")


def test_two_processes_may_write_one_file_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The second one renamed what the first one was writing, which then found nothing to rename."""
    path = tmp_path / "sweep.about"

    def write(part: Path) -> None:
        part.write_text("one")
        with monkeypatch.context() as other:
            other.setattr(files.os, "getpid", lambda: 1)
            write_whole(path, lambda its: its.write_text("other"), advice="")

    write_whole(path, write, advice="")
    assert [(file.name, file.read_text()) for file in tmp_path.iterdir()] == [("sweep.about", "one")]
