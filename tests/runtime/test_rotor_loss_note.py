"""After a flight with a rotor that lost too much thrust the next one is refused until somebody has looked."""

from pathlib import Path

import pytest

from dynamics.errors import VehicleError
from runtime.rotor_loss_note import require_no_note, write_note


def test_the_next_flight_is_refused_until_the_note_is_deleted(tmp_path: Path) -> None:
    require_no_note(None, "v")
    require_no_note(tmp_path, "v")
    path = write_note(tmp_path, "v", "rotor 2 has lost 30 +- 4 % of thrust")
    with pytest.raises(VehicleError, match=r"rotor 2 has lost 30 .* delete "):
        require_no_note(tmp_path, "v")
    require_no_note(tmp_path, "another vehicle")
    path.unlink()
    require_no_note(tmp_path, "v")
