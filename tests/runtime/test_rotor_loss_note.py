"""After a flight with a rotor that lost too much thrust the next one is refused until somebody has looked."""

import errno
from pathlib import Path

import pytest

from dynamics.errors import VehicleError
from runtime.rotor_loss_note import leave_note, note_path, require_no_note, write_note


def test_the_next_flight_is_refused_until_the_note_is_deleted(tmp_path: Path) -> None:
    require_no_note(None, "v")
    require_no_note(tmp_path, "v")
    path = write_note(tmp_path, "v", "rotor 2 has lost 30 +- 4 % of thrust")
    with pytest.raises(VehicleError, match=r"rotor 2 has lost 30 .* delete "):
        require_no_note(tmp_path, "v")
    require_no_note(tmp_path, "another vehicle")
    path.unlink()
    require_no_note(tmp_path, "v")


def test_a_note_that_cannot_be_written_is_announced_and_leaves_no_part_of_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write = Path.write_text

    def full(path: Path, text: str, encoding: str) -> int:
        write(path, text[:5], encoding=encoding)
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Path, "write_text", full)
    announced = leave_note(tmp_path, "v", "rotor 2 has lost 30 +- 4 % of thrust")
    assert announced.startswith("the next take-off is NOT refused")
    assert "No space left on device" in announced
    assert list(tmp_path.iterdir()) == []
    require_no_note(tmp_path, "v")


def test_what_is_announced_of_a_note_says_how_to_fly_again(tmp_path: Path) -> None:
    announced = leave_note(tmp_path, "v", "rotor 2 has lost 30 +- 4 % of thrust")
    assert announced == f"no take-off until {note_path(tmp_path, 'v')} is deleted"
    assert "recorded" in leave_note(None, "v", "rotor 2 has lost 30 +- 4 % of thrust")
