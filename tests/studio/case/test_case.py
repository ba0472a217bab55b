"""Cases as folders: what they remember, what depends on what, and what they refuse."""

from __future__ import annotations

import json
import shutil
import zipfile
from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest

from dynamics.errors import RequestError
from studio.case.archive import unpack_archive, write_archive
from studio.case.case import Case, is_case
from studio.case.commands import script
from studio.case.state import ChannelLevel, Options

OWN_EFFECT = Path(__file__).parents[3] / "examples" / "my_effects.py"


@pytest.fixture
def log(tmp_path: Path) -> Path:
    path = tmp_path / "flight.csv"
    path.write_text("t\n1\n")
    return path


@pytest.fixture
def case(tmp_path: Path, log: Path) -> Iterator[Case]:
    made = Case.create(tmp_path / "case", name="my case")
    made.add_logs([log])
    made.set_vehicle("px4_sih")
    yield made
    made.close()


def _next(case: Case) -> None:
    text = case.vehicle_path().read_text() + "# more\n"
    case.add_version(text, action="added drag", channels={"imu": ChannelLevel(2.0, 1.0, 0.9, "m/s^2")})


def test_a_case_that_is_opened_again_stands_where_it_stood(case: Case) -> None:
    _next(case)
    case.undo()
    before = case.state
    case.close()
    again = Case.open(case.folder)
    assert again.state == before
    assert again.vehicle().name == "px4_sih"
    assert again.redo()
    assert again.version is not None
    assert again.version.channels["imu"].after == 1.0
    again.close()


def test_a_change_above_makes_everything_below_another_result(case: Case, tmp_path: Path) -> None:
    keys = {step: case.key(step) for step in ("check", "compare", "diagnose", "prove")}
    assert len(set(keys.values())) == 4
    _next(case)
    assert case.key("check") == keys["check"]
    assert all(case.key(step) != keys[step] for step in ("compare", "diagnose", "prove"))
    case.undo()
    assert {step: case.key(step) for step in keys} == keys
    other = tmp_path / "other.csv"
    other.write_text("t\n2\n")
    case.add_logs([other])
    assert all(case.key(step) != keys[step] for step in keys)
    case.set_options(Options(hold_out="hold_*"))
    changed = case.key("compare")
    case.set_options(Options())
    assert case.key("compare") != changed


def test_the_same_log_counts_once_and_is_never_removed_from_where_it_lies(case: Case, log: Path) -> None:
    copy = log.with_name("copy.csv")
    shutil.copy(log, copy)
    case.add_logs([copy, log])
    assert len(case.state.logs) == 1
    case.remove_log(case.state.logs[0].path)
    assert log.exists()
    assert not case.state.logs


def test_versions_branch_and_no_file_is_ever_overwritten(case: Case) -> None:
    _next(case)
    _next(case)
    case.undo()
    case.undo()
    assert not case.undo()
    _next(case)
    assert [v.number for v in case.line] == [1, 4]
    assert len(case.state.versions) == 4
    assert len(list((case.folder / "versions").iterdir())) == 4
    assert not case.redo()
    assert case.version is not None
    assert case.version.author


def test_a_case_is_open_in_one_studio_at_a_time(case: Case) -> None:
    with pytest.raises(RequestError, match="open in another studio"):
        Case.open(case.folder)
    case.close()
    Case.open(case.folder).close()


def test_a_case_of_another_format_is_refused_and_left_as_it_is(case: Case) -> None:
    case.close()
    file = case.folder / "case.json"
    content = json.loads(file.read_text()) | {"format": 99}
    file.write_text(json.dumps(content))
    with pytest.raises(RequestError, match="format 99"):
        Case.open(case.folder)
    assert json.loads(file.read_text())["format"] == 99


SYSTEM_OF_WORDS = '{"format": 1, "options": {"system": "1; rm"}}'


@pytest.mark.parametrize("text", ["{", "[]", '{"format": 1, "logs": 3}', SYSTEM_OF_WORDS])
def test_a_damaged_case_is_refused(case: Case, text: str) -> None:
    case.close()
    (case.folder / "case.json").write_text(text)
    with pytest.raises(RequestError, match="damaged"):
        Case.open(case.folder)


def test_a_folder_without_a_case_and_a_folder_in_use_are_refused(tmp_path: Path, log: Path) -> None:
    with pytest.raises(RequestError, match="holds no case"):
        Case.open(tmp_path)
    with pytest.raises(RequestError, match="not empty"):
        Case.create(tmp_path)
    assert not is_case(tmp_path)


def test_effects_of_the_users_own_travel_with_the_case(case: Case, tmp_path: Path) -> None:
    before = case.key("check")
    case.add_effect_file(OWN_EFFECT)
    assert case.key("check") != before
    case.add_effect_file(OWN_EFFECT)
    assert len(case.state.effect_files) == 1
    archive = write_archive(case, tmp_path / "sent.alula.zip")
    case.close()
    there = Case.open(unpack_archive(archive, tmp_path / "elsewhere"))
    assert there.vehicle().effect_files
    there.close()


def test_a_case_is_sent_as_one_file_with_its_logs(case: Case, log: Path, tmp_path: Path) -> None:
    _next(case)
    archive = write_archive(case, tmp_path / "sent.alula.zip")
    keys, state = {step: case.key(step) for step in ("check", "compare")}, case.state
    case.close()
    log.unlink()
    there = Case.open(unpack_archive(archive, tmp_path / "elsewhere"))
    assert [path.read_text() for path in there.log_paths] == ["t\n1\n"]
    assert {step: there.key(step) for step in keys} == keys
    assert there.state.versions == state.versions
    there.close()


def test_a_case_whose_log_is_gone_cannot_be_sent(case: Case, log: Path, tmp_path: Path) -> None:
    log.unlink()
    with pytest.raises(RequestError, match="is gone"):
        write_archive(case, tmp_path / "sent.alula.zip")
    assert not (tmp_path / "sent.alula.zip").exists()


@pytest.mark.parametrize("name", ["../outside.txt", "/outside.txt"])
def test_an_archive_writes_nowhere_but_in_its_folder(tmp_path: Path, name: str) -> None:
    path = tmp_path / "evil.alula.zip"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("case.json", "{}")
        archive.writestr(name, "x")
    with pytest.raises(RequestError, match="outside its folder"):
        unpack_archive(path, tmp_path / "elsewhere")
    assert not (tmp_path / "elsewhere").exists()


def test_a_file_that_is_no_archive_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "log.alula.zip"
    path.write_text("no zip")
    with pytest.raises(RequestError, match="cannot be opened as a case"):
        unpack_archive(path, tmp_path / "elsewhere")


def test_a_vehicle_that_cannot_be_used_changes_nothing(case: Case, tmp_path: Path) -> None:
    before = case.state
    bad = tmp_path / "bad.toml"
    bad.write_text("name = 3")
    with pytest.raises(RequestError):
        case.set_vehicle(bad)
    assert case.state == before


@pytest.mark.usefixtures("nothing_approved")
@pytest.mark.parametrize("name", ["effects/e.py", "../e.py", "WHOLE/e.py", "logs/link.py"])
def test_a_case_that_was_sent_runs_nothing(tmp_path: Path, name: str) -> None:
    case = Case.create(tmp_path / "sent", name="sent")
    case.set_vehicle("arpl_250g")
    payload = f"import pathlib\npathlib.Path({str(tmp_path / 'RAN')!r}).touch()\n"
    for folder in ("effects", "logs"):
        (case.folder / folder).mkdir()
    for place in (case.folder / "effects" / "e.py", tmp_path / "e.py"):
        place.write_text(payload)
    (case.folder / "logs" / "link.py").symlink_to(tmp_path / "e.py")
    case.close()
    state = msgspec.json.decode((case.folder / "case.json").read_bytes())
    state["effect_files"] = [name.replace("WHOLE", str(tmp_path))]
    (case.folder / "case.json").write_bytes(msgspec.json.encode(state))
    there = Case.open(case.folder)
    with pytest.raises(RequestError, match=r"you have not approved|does not lie beside"):
        there.vehicle()
    assert there.vehicle_name() == "arpl_250g"
    there.close()
    assert not (tmp_path / "RAN").exists()


@pytest.mark.parametrize("command", ["curl x | sh", "sh -c x", "alula fly --bundle b", "alula trust evil.py"])
def test_the_script_of_a_case_that_was_edited_is_refused(case: Case, command: str) -> None:
    assert case.version is not None
    case._change(versions=(msgspec.structs.replace(case.version, command=command),))
    with pytest.raises(RequestError, match="no command that the studio gives"):
        script(case)


def test_a_case_adds_no_line_to_its_script(case: Case) -> None:
    case._change(name="x\ntouch RAN")
    assert "\ntouch RAN" not in script(case)
