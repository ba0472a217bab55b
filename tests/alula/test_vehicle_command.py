"""`alula vehicle`: a file from parts, a picture, and what a wrong number ends with."""

import json
import sys
from pathlib import Path

import pytest

from alula.cli.app import main
from dynamics.vehicle_file import read_vehicle

PARTS = ("--mass", "1500g", "--arm", "225mm", "--propeller", "10in", "--kv", "920", "--cells", "4")


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path):
    """Run a command in an empty folder; returns exit code, standard output, standard error."""
    monkeypatch.chdir(tmp_path)

    def ended(*arguments: str) -> tuple[object, str, str]:
        monkeypatch.setattr(sys, "argv", ["alula", "vehicle", *arguments])
        with pytest.raises(SystemExit) as caught:
            main()
        return (caught.value.code, *capsys.readouterr())

    return ended


def test_parts_make_a_file_with_sources_and_the_next_command(run) -> None:
    code, shown, _ = run("new", "mine", *PARTS)
    assert code == 0
    assert shown.splitlines()[-1] == "next: alula vehicle show mine.toml"
    vehicle = read_vehicle("mine.toml")
    assert vehicle.body.mass == 1.5
    assert 1.5 < vehicle.rotors.thrust_max / vehicle.weight < 8.0
    text = Path("mine.toml").read_text()
    assert "# rule: C_T = 0.11" in text
    assert "+-" in text
    code, _, message = run("new", "mine", *PARTS)
    assert code == 2
    assert "never overwritten" in message


def test_a_picture_is_drawn_and_the_rotors_are_listed(run) -> None:
    run("new", "mine", *PARTS, "--frame", "hexa_x", "--arm", "0.3")
    code, shown, _ = run("show", "mine.toml")
    assert code == 0
    assert Path("mine.png").stat().st_size > 10_000
    assert "rotor 4 (front right; motor 5)" in shown
    assert shown.splitlines()[-1].startswith("next: alula mock")
    code, shown, _ = run("show", "mine.toml", "--out", "mine.svg", "--json", "-")
    assert json.loads(shown)["rotors"][0]["turns"] == "clockwise"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("new", "x"), "--mass, --arm, --propeller, --kv, --cells missing"),
        (("new", "x", *PARTS, "--mass", "1,5"), "no number"),
        (("new", "x", *PARTS, "--arm", "225"), "arm = 225"),
        (("new", "x", *PARTS, "--propeller", "20in"), "would touch"),
        (("new", "x", *PARTS, "--frame", "quadx"), "did you mean 'quad_x'"),
        (("show", "nowhere.toml"), "nowhere.toml"),
        (("show", "px4_sih", "--out", "a.bmp"), ".png"),
        (("from-log", "nowhere.ulg"), "nowhere.ulg"),
    ],
)
def test_a_wrong_number_or_file_is_refused(run, arguments: tuple[str, ...], words: str) -> None:
    code, _, message = run(*arguments)
    assert code == 2
    assert words in " ".join(message.split())
