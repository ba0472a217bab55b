"""A case that somebody sent reads, sends, deletes and quotes nothing of this computer."""

from __future__ import annotations

import json
import os
import shutil
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest

from dynamics.approvals import store_path
from dynamics.errors import RequestError
from dynamics.inside import path_inside
from studio.case.archive import unpack_archive, write_archive
from studio.case.case import Case
from studio.case.commands import command
from studio.case.links import NAME, LinkedLog, links_of, set_links
from studio.case.state import CaseState, Options
from studio.case.state_file import LOCK_FILE
from tests.support.command_line import Run, command_line

SECRET = "SECRET of another file"
ELSEWHERE = (
    "WHOLE/secret",
    "../secret",
    "logs/../../secret",
    "logs/link",
    "linked/secret",
    "logs//../../secret",
    "logs/\0",
)
Edit = Callable[[dict[str, Any], str], None]


def _set_log(state: dict[str, Any], name: str) -> None:
    state["logs"][0]["path"] = name


def _set_version(state: dict[str, Any], name: str) -> None:
    state["versions"][0]["file"] = name


def _set_mapping(state: dict[str, Any], name: str) -> None:
    state["options"]["mapping"] = name


def _set_shown(state: dict[str, Any], name: str) -> None:
    state["shown"]["check"] = f"x/../../{name}"


EDITS = (_set_log, _set_version, _set_mapping, _set_shown)


@pytest.fixture
def secret(tmp_path: Path) -> Path:
    path = tmp_path / "secret"
    path.write_text(SECRET)
    return path


@pytest.fixture
def sent(tmp_path: Path, secret: Path) -> Path:
    """The folder of a case with a log of its own, and links out of it."""
    case = Case.create(tmp_path / "sent")
    (case.folder / "logs").mkdir()
    (case.folder / "logs" / "flight.csv").write_text("t\n5\n")
    case.add_logs([case.folder / "logs" / "flight.csv"])
    case.set_vehicle("px4_sih")
    case.close()
    (case.folder / "logs" / "link").symlink_to(secret)
    (case.folder / "linked").symlink_to(tmp_path)
    return case.folder


def _edit(folder: Path, edit: Edit, name: str) -> None:
    file = folder / "case.json"
    state = json.loads(file.read_text())
    edit(state, name)
    file.write_text(json.dumps(state))


def _zipped(folder: Path, path: Path) -> Path:
    with zipfile.ZipFile(path, "w") as archive:
        for file in folder.rglob("*"):
            if file.is_file() and not file.is_symlink() and file.name != LOCK_FILE:
                archive.write(file, str(file.relative_to(folder)))
    return path


@pytest.mark.parametrize("edit", EDITS, ids=lambda edit: edit.__name__)
@pytest.mark.parametrize("name", ELSEWHERE)
def test_a_case_whose_paths_lead_elsewhere_is_not_opened(sent: Path, secret: Path, edit: Edit, name: str) -> None:
    _edit(sent, edit, name.replace("WHOLE", str(secret.parent)))
    with pytest.raises(RequestError, match="not in its folder") as refused:
        Case.open(sent)
    assert SECRET not in str(refused.value)
    assert secret.read_text() == SECRET


@pytest.mark.parametrize("edit", EDITS, ids=lambda edit: edit.__name__)
def test_an_archive_whose_paths_lead_elsewhere_leaves_nothing(sent: Path, tmp_path: Path, edit: Edit) -> None:
    _edit(sent, edit, str(tmp_path / "secret"))
    with pytest.raises(RequestError, match="not in its folder"):
        unpack_archive(_zipped(sent, tmp_path / "evil.zip"), tmp_path / "cases" / "evil")
    assert list((tmp_path / "cases").iterdir()) == []


@pytest.mark.parametrize("edit", EDITS, ids=lambda edit: edit.__name__)
def test_each_use_of_a_path_looks_at_it_again(sent: Path, secret: Path, tmp_path: Path, edit: Edit) -> None:
    case = Case.open(sent)
    state = json.loads((sent / "case.json").read_text())
    edit(state, str(secret))
    case._state = type(case.state)(**{**_fields(case), **_changed(state)})
    uses: dict[Edit, list[Callable[[], object]]] = {
        _set_log: [
            lambda: case.log_paths, lambda: write_archive(case, tmp_path / "out.zip"), lambda: command(case, "check"),
            lambda: case.remove_log(str(secret)),
        ],
        _set_version: [case.vehicle, case.vehicle_path, case.vehicle_name, lambda: case.key("compare")],
        _set_mapping: [lambda: case.mapping_path, lambda: command(case, "check")],
        _set_shown: [lambda: case.shown_result("check")],
    }  # fmt: skip
    for use in uses[edit]:
        with pytest.raises(RequestError, match="not in its folder") as refused:
            use()
        assert SECRET not in str(refused.value)
    case.close()
    assert secret.read_text() == SECRET
    assert not (tmp_path / "out.zip").exists()


def _fields(case: Case) -> dict[str, Any]:
    return {name: getattr(case.state, name) for name in case.state.__struct_fields__}


def _changed(state: dict[str, Any]) -> dict[str, Any]:
    changed = msgspec.convert(state, CaseState)
    return {name: getattr(changed, name) for name in ("logs", "versions", "options", "shown")}


@pytest.mark.parametrize("name", ["versions/0001.toml", "case.json", "logs/also"])
def test_removing_a_log_deletes_logs_alone(sent: Path, name: str) -> None:
    (sent / "logs" / "also").symlink_to(sent / "versions" / "0001.toml")
    _edit(sent, _set_log, name)
    case = Case.open(sent)
    case.remove_log(name)
    case.close()
    assert (sent / "versions" / "0001.toml").is_file()
    assert (sent / "case.json").is_file()


@pytest.mark.parametrize("folder", ["logs", "versions", "results", "effects", "mappings"])
def test_a_folder_that_is_a_link_out_of_the_case_is_refused(sent: Path, tmp_path: Path, folder: str) -> None:
    shutil.rmtree(sent / folder, ignore_errors=True)
    (sent / folder).symlink_to(tmp_path)
    with pytest.raises(RequestError, match="not in its folder"):
        Case.open(sent)


@pytest.mark.parametrize("name", ["results/leak.json", "versions/leak.toml", "results/folder"])
def test_a_link_out_of_the_case_is_not_sent(sent: Path, secret: Path, tmp_path: Path, name: str) -> None:
    (sent / name).parent.mkdir(exist_ok=True)
    (sent / name).symlink_to(secret.parent if name.endswith("folder") else secret)
    case = Case.open(sent)
    with pytest.raises(RequestError, match="not in its folder"):
        write_archive(case, tmp_path / "out.zip")
    case.close()
    assert not list(tmp_path.glob("out.zip*"))


@pytest.mark.parametrize("name", [LOCK_FILE, "case.json"])
def test_opening_a_case_cuts_off_no_file_that_a_link_leads_to(sent: Path, secret: Path, name: str) -> None:
    (sent / name).unlink(missing_ok=True)
    (sent / name).symlink_to(secret)
    with pytest.raises(RequestError):
        Case.open(sent)
    assert secret.read_text() == SECRET


def test_a_pipe_in_place_of_a_case_is_refused_at_once(sent: Path) -> None:
    for name in (LOCK_FILE, "case.json"):
        (sent / name).unlink(missing_ok=True)
        os.mkfifo(sent / name)
        with pytest.raises(RequestError):
            Case.open(sent)
        (sent / name).unlink()


def test_versions_that_go_round_are_refused(sent: Path) -> None:
    _edit(sent, lambda state, _: state["versions"][0].update(parent=1), "")
    with pytest.raises(RequestError, match="do not follow"):
        Case.open(sent)


# --- a user's own logs, which stay where they are


@pytest.fixture
def own(tmp_path: Path) -> Iterator[Case]:
    log = tmp_path / "flights" / "flight.csv"
    log.parent.mkdir()
    log.write_text("t\n1\n")
    case = Case.create(tmp_path / "own")
    case.add_logs([log])
    case.set_vehicle("px4_sih")
    yield case
    case.close()


def test_a_log_of_the_command_line_stays_where_it_is_and_its_case_names_no_path_of_this_computer(
    own: Case, tmp_path: Path
) -> None:
    log = tmp_path / "flights" / "flight.csv"
    assert own.log_paths == (log,)
    assert str(tmp_path) not in (own.folder / "case.json").read_text()
    assert [entry.path for entry in own.state.logs] == ["logs/flight.csv"]
    own.close()
    again = Case.open(own.folder)
    assert again.log_paths == (log,)
    again.remove_log("logs/flight.csv")
    again.close()
    assert log.is_file()
    assert links_of(own.folder) == ()


def test_two_logs_of_one_name_are_two(own: Case, tmp_path: Path) -> None:
    other = tmp_path / "others" / "flight.csv"
    other.parent.mkdir()
    other.write_text("t\n2\n")
    own.add_logs([other])
    assert own.log_paths == (tmp_path / "flights" / "flight.csv", other)
    there = Case.open(unpack_archive(write_archive(own, tmp_path / "sent.zip"), tmp_path / "elsewhere"))
    assert [path.read_text() for path in there.log_paths] == ["t\n1\n", "t\n2\n"]
    there.close()


def test_a_case_of_a_stranger_at_the_place_of_an_own_one_gets_none_of_its_logs(own: Case, sent: Path) -> None:
    place = own.folder
    own.close()
    shutil.rmtree(place)
    shutil.copytree(sent, place, symlinks=True)
    _edit(place, _set_log, "logs/flight.csv")
    case = Case.open(place)
    assert case.log_paths == (place / "logs" / "flight.csv",)
    case.close()


def test_a_case_that_was_moved_finds_its_logs_again_when_they_are_given(
    own: Case, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    run: Run = command_line(monkeypatch, capsys)
    own.close()
    moved = own.folder.rename(tmp_path / "moved")
    log = (tmp_path / "flights" / "flight.csv").rename(tmp_path / "renamed.csv")
    case = Case.open(moved)
    assert not case.log_paths[0].exists()
    case.close()
    case = Case.open(moved, logs=[log])
    assert case.log_paths == (log,)
    keys = case.key("check")
    case.close()
    case = Case.open(moved)
    assert case.key("check") == keys
    case.close()
    stranger = tmp_path / "stranger.csv"
    stranger.write_text("t\n9\n")
    code, _, wrong = run("studio", stranger, "--case", moved, "--no-browser")
    assert code == 2
    assert "holds a case already" in wrong


def test_a_case_of_an_earlier_version_says_how_its_logs_are_taken_in(own: Case, tmp_path: Path) -> None:
    log, mapping = tmp_path / "flights" / "flight.csv", tmp_path / "map.toml"
    mapping.write_text("# a mapping\n")
    own.close()
    set_links(own.folder, ())

    def earlier(state: dict[str, Any], name: str) -> None:
        _set_log(state, name)
        _set_mapping(state, str(mapping))

    _edit(own.folder, earlier, str(log))
    with pytest.raises(RequestError, match=r"`alula studio FILE --case FOLDER`"):
        Case.open(own.folder)
    case = Case.open(own.folder, logs=[log], mapping=mapping)
    assert case.log_paths == (log,)
    assert case.mapping_path == own.folder / "mappings" / "map.toml"
    case.close()
    Case.open(own.folder).close()


def test_a_mapping_travels_with_its_case(own: Case, tmp_path: Path) -> None:
    mapping = tmp_path / "map.toml"
    mapping.write_text("# first\n")
    own.set_options(Options(mapping=str(mapping)))
    first = own.key("check")
    own.set_options(Options(mapping=own.state.options.mapping))  # as the page gives it back
    assert own.key("check") == first
    mapping.write_text("# second\n")
    own.set_options(Options(mapping=str(mapping)))
    assert own.key("check") != first
    there = Case.open(unpack_archive(write_archive(own, tmp_path / "sent.zip"), tmp_path / "elsewhere"))
    assert there.mapping_path is not None
    assert there.mapping_path.read_text() == "# second\n"
    there.close()
    with pytest.raises(RequestError, match="cannot read the mapping"):
        own.set_options(Options(mapping=str(tmp_path / "none.toml")))


@pytest.mark.usefixtures("nothing_approved")
def test_a_list_of_links_that_others_may_write_is_refused(tmp_path: Path) -> None:
    set_links(tmp_path, [LinkedLog(str(tmp_path), "logs/a.csv", "0" * 64, "/a.csv")])
    file = store_path().with_name(NAME)
    assert file.stat().st_mode & 0o777 == 0o600
    assert len(links_of(tmp_path)) == 1
    file.chmod(0o666)
    with pytest.raises(RequestError, match="others may write"):
        links_of(tmp_path)
    file.chmod(0o600)
    file.write_text("[")
    with pytest.raises(RequestError, match="damaged"):
        links_of(tmp_path)


@pytest.mark.parametrize(
    "name",
    ["", ".", "..", "/", "/a", "a/..", "a/../b", "./a", "a//b", "a/", "a/./b", "a\0", "up/x", "round", "../in/a"],
)
def test_paths_that_are_not_normal_or_lead_out_are_none(tmp_path: Path, name: str) -> None:
    folder = tmp_path / "in"
    folder.mkdir()
    (folder / "up").symlink_to(tmp_path)
    (folder / "round").symlink_to(folder / "round")
    (folder / "within").symlink_to(folder / "new")
    assert path_inside(folder, name) is None
    assert path_inside(folder, "new/file") == folder / "new" / "file"
    assert path_inside(folder, "within") == folder / "within"
