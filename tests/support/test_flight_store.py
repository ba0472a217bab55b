"""Flights that are kept: flown once, flown again when the request or the simulator changes."""

from pathlib import Path
from types import MappingProxyType

import pytest

from fixtures import flight_store
from fixtures.flight_store import stored, stored_together


@pytest.fixture
def flown(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The flights that were flown; a folder of this test's own."""
    monkeypatch.setenv("ALULA_FLIGHTS", str(tmp_path))
    return []


def fly(flown: list[str], name: str) -> MappingProxyType[str, int]:
    """A flight, which takes note of itself."""
    flown.append(name)
    return MappingProxyType({name: len(flown)})


def test_a_flight_is_flown_once_and_read_as_it_was(flown: list[str]) -> None:
    first = stored(lambda: fly(flown, "circle"), "circle", 1)
    again = stored(lambda: fly(flown, "circle"), "circle", 1)
    assert flown == ["circle"]
    assert first == again == {"circle": 1}


def test_another_request_or_another_simulator_flies_again(flown: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    stored(lambda: fly(flown, "circle"), "circle", 1)
    stored(lambda: fly(flown, "circle"), "circle", 2)
    monkeypatch.setattr(flight_store, "_sources", lambda: "changed")
    stored(lambda: fly(flown, "circle"), "circle", 1)
    assert flown == ["circle"] * 3


def test_a_flight_that_fails_is_not_kept(flown: list[str], tmp_path: Path) -> None:
    with pytest.raises(ZeroDivisionError):
        stored(lambda: 1 / 0, "crash")
    assert stored(lambda: 2.0, "crash") == 2.0


def test_nothing_is_kept_without_a_folder(flown: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ALULA_FLIGHTS", "")
    for _ in range(2):
        stored(lambda: fly(flown, "circle"), "circle")
    assert flown == ["circle"] * 2


def test_flights_side_by_side_are_kept_one_by_one(flown: list[str]) -> None:
    def together(names: list[str]) -> list[str]:
        flown.append("+".join(names))
        return [name.upper() for name in names]

    assert stored_together(together, ["circle", "line"]) == ["CIRCLE", "LINE"]
    assert stored_together(together, ["line", "bob", "circle"]) == ["LINE", "BOB", "CIRCLE"]
    assert stored(lambda: 1 / 0, "bob") == "BOB"
    assert flown == ["circle+line", "bob"]
