"""The judge's file of cases: what it names is there, and each case has a name of its own."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.verdict.cases import SourcedEntry, planned, read_sets
from benchmarks.verdict.posing import SOURCES, expected_of
from benchmarks.verdict.scoring import NAMES
from dynamics.effects import CATALOGUE
from dynamics.errors import RequestError
from dynamics.vehicle_file import find_vehicle
from fixtures.foreign_effects import FOREIGN
from fixtures.mutated_flights import MUTATIONS
from fixtures.outside_draws import KINDS
from fixtures.outside_sih import HIDDEN_CHANGES
from fixtures.real_flights import DATA, SETS

CASES = read_sets()
ENTRIES = [entry for each in CASES.values() for entry in each.cases]
LISTED = {
    "px4_like": tuple(HIDDEN_CHANGES),
    "mutated": tuple(MUTATIONS),
    "statements": tuple(real.name for real in SETS),
}


def of(*sources: str) -> list[SourcedEntry]:
    """Entries of sources."""
    return [entry for entry in ENTRIES if entry.source in sources]


def test_every_source_and_every_recorder_of_the_outside_simulator_is_asked() -> None:
    assert {entry.source for entry in ENTRIES} == {*SOURCES, "statements"}
    assert {entry.recorder for entry in of("outside")} == set(KINDS)


def test_every_effect_that_the_outside_simulator_makes_is_asked() -> None:
    made = {(entry.recorder, entry.name) for entry in of("outside")}
    assert made == {(kind, name) for kind, names in KINDS.items() for name in names}


@pytest.mark.parametrize("source", LISTED)
def test_names_are_known_to_their_source(source: str) -> None:
    assert {entry.name for entry in of(source)} <= set(LISTED[source])


def test_every_statement_and_every_mutation_is_asked() -> None:
    assert {entry.name for entry in of("statements", "mutated")} == {*LISTED["statements"], *LISTED["mutated"]}


def test_hidden_effects_have_the_parameters_of_the_catalogue() -> None:
    for entry in ENTRIES:
        for name, values in entry.hidden.items():
            effect = CATALOGUE.get(name) or FOREIGN[name]
            assert set(values) - {"rotor"} <= {p.name for p in effect.parameters}, entry.name


def test_bundled_logs_are_there() -> None:
    files = [DATA / name for entry in of("bundled") for name in (*entry.files, *entry.normal)]
    assert files
    assert all(file.exists() for file in files)
    assert all(find_vehicle(entry.vehicle).exists() for entry in of("bundled"))


def test_keys_are_unique_and_seeds_follow_one_another() -> None:
    cases = planned(CASES, list(CASES), 500, None)
    assert len({case.key for case in cases}) == len(cases)
    assert {case.seed for case in cases if case.set_name == "short"} == set(range(500, 506))
    assert min(case.seed for case in cases) == 500


def test_a_limit_takes_cases_from_the_whole_of_a_set() -> None:
    cases = planned(CASES, ["short", "captured"], 1, 3)
    assert [case.set_name for case in cases] == ["short"] * 3 + ["captured"] * 3
    assert len({case.entry.recorder for case in cases[3:]}) > 1


def test_sets_that_are_not_there_are_refused_with_those_that_are() -> None:
    with pytest.raises(RequestError, match=r"captive: no such set\. There are planted, captured"):
        planned(CASES, ["captive"], 1, None)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('[a]\ntitle = "a"\ncases = [{name = "x", source = "own", nois = 2.0}]', "nois"),
        ('[a]\ntitle = "a"\ncases = [{name = "x", source = "own"}, {name = "x", source = "own"}]', "twice"),
        ('[a]\ntitle = "a"\ncases = [{name = "x", source = "there"}]', "there"),
    ],
    ids=["unknown field", "name given twice", "unknown source"],
)
def test_a_wrong_entry_is_refused(tmp_path: Path, text: str, message: str) -> None:
    file = tmp_path / "cases.toml"
    file.write_text(text)
    with pytest.raises(RequestError, match=message):
        read_sets(file)


def test_an_effect_of_no_catalogue_is_answered_with_unknown() -> None:
    case = planned(CASES, ["planted"], 1, None)[0]
    truth = expected_of(case, {"swirling": {"amplitude": 0.05}})
    assert (truth.hidden, truth.required, truth.allowed, truth.outside) == ({}, (), ("unknown",), True)
    hidden = {name: {"loss": 0.1, "rotor": 1.0} for name in ("lost_propeller", "weak_rotor")}
    assert "lost_propeller" in NAMES
    assert expected_of(case, hidden).required == ("lost_propeller", "weak_rotor")
