"""`alula effects`: every effect is described, and what a user asks for is there."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

import alula
from dynamics.effects import CATALOGUE

OWN = Path("examples/my_effects.py")


def effects(*arguments: str) -> subprocess.CompletedProcess[str]:
    """The command's end."""
    return subprocess.run(
        [sys.executable, "-m", "alula", "effects", *arguments], capture_output=True, text=True, check=False
    )


def test_every_effect_has_formula_source_and_something_to_fly() -> None:
    for card in alula.describe_effects(vehicle="arpl_250g"):
        name, parameters = card.effect.name, card.effect.parameters
        assert card.formula, name
        assert card.effect.source, name
        assert card.fly, name
        assert card.needs, name
        assert all(p.lower <= p.neutral <= p.upper or p.neutral == 0.0 for p in parameters), name
        assert all(card.usual(p) is not None for p in parameters)


def test_what_looks_alike_does_so_both_ways() -> None:
    alike = {card.effect.name: set(card.confounded_with) for card in alula.describe_effects()}
    assert all(name in alike[other] for name, others in alike.items() for other in others)


def test_the_list_has_every_effect_and_says_what_next() -> None:
    done = effects()
    assert done.returncode == 0, done.stderr
    assert all(name in done.stdout for name in CATALOGUE)
    assert done.stdout.strip().splitlines()[-1].startswith("next: alula effects")


def test_one_effect_is_described_for_a_vehicle_and_as_json() -> None:
    done = effects("rotor_drag", "--vehicle", "arpl_250g", "--json", "-")
    assert done.returncode == 0, done.stderr
    (card,) = json.loads(done.stdout)
    assert card["name"] == "rotor_drag"
    assert card["parameters"][0]["usual"] == pytest.approx(1.5e-5, rel=0.1)


def test_effects_of_ones_own_are_listed() -> None:
    names = {card.effect.name for card in alula.describe_effects(effect_files=[OWN])} - set(CATALOGUE)
    assert names
    done = effects(next(iter(names)), "--effects", str(OWN))
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("arguments", [("rotor_drg",), ("--vehicle", "nowhere.toml"), ("--effects", "nowhere.py")])
def test_a_wrong_name_or_file_is_refused(arguments: tuple[str, ...]) -> None:
    done = effects(*arguments)
    assert done.returncode == 2
    assert "Traceback" not in done.stderr


def test_the_nearest_name_is_named() -> None:
    with pytest.raises(alula.RequestError, match="did you mean 'rotor_drag'"):
        alula.describe_effects(["rotor_drg"])
