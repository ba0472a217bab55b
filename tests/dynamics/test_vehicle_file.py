"""Vehicle files: what is refused and in which words, and that nothing is lost or overwritten."""

import re
import stat
import tomllib
from pathlib import Path

import msgspec
import pytest

from dynamics.effects import CATALOGUE
from dynamics.errors import RequestError
from dynamics.vehicle import EffectUse, HistoryEntry, Limits
from dynamics.vehicle_file import effect_text, find_vehicle, parse_effect, parse_vehicle, read_vehicle, write_vehicle
from vehicles import FOLDER

GOOD = (FOLDER / "arpl_250g.toml").read_text()


def refusal(text):
    """The message with which a vehicle file's text is refused."""
    with pytest.raises(RequestError) as caught:
        parse_vehicle(text)
    return str(caught.value)


def replaced(old, new):
    """A good vehicle file with one part replaced."""
    assert old in GOOD
    return GOOD.replace(old, new)


def with_effect(text):
    """A good vehicle file with an effect behind it."""
    return f"{GOOD}\n[[effects]]\n{text}"


def test_the_bundled_vehicles_can_be_read():
    names = {read_vehicle(path).name for path in FOLDER.glob("*.toml")}
    assert {"arpl_250g", "px4_sih"} <= names


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("mass =", "mas =", ["unknown key 'mas' in [body]", "did you mean 'mass'", "Known there: mass, inertia"]),
        ("thrust_constant =", "trust_constant =", ["'trust_constant' in [rotors]", "did you mean 'thrust_constant'"]),
        ("[limits]", "[limit]", ["unknown key 'limit'", "did you mean 'limits'"]),
        ('name = "arpl_250g"', 'name = "a"\nzzz = 1', ["unknown key 'zzz'", "Known there: name, body"]),
        (
            "[6.01e-4, 5.89e-4, 1.076e-3]",
            "[6.01e-4, 5.89e-4, 1.076e-2]",
            ["impossible inertia", "sum of the other two"],
        ),
        ("[6.01e-4, 5.89e-4, 1.076e-3]", "[6.01e-4, -5.89e-4, 1.076e-3]", ["body.inertia[1]", "above 0"]),
        ("[6.01e-4, 5.89e-4, 1.076e-3]", "[6.01e-4, 5.89e-4]", ["body.inertia", "3 entries"]),
        ("spin = [1, -1, 1, -1]", "spin = [1, 1, 1, -1]", ["sums to 2", "must cancel", "[1, -1, 1, -1]"]),
        ("spin = [1, -1, 1, -1]", "spin = [1, 1, -1, -1]", ["independently", "diagonal"]),
        ("mass = 0.25 ", 'mass = "heavy"', ["body.mass holds a text", "wanted is a number"]),
        ("mass = 0.25 ", "mass = 0.0", ["body.mass", "above 0"]),
        ("mass = 0.25 ", "mass = nan", ["body.mass", "finite"]),
        ("mass = 0.25 ", "mass = inf", ["body.mass", "finite"]),
        ("[[0.076,", "[[nan,", ["rotors.position", "finite"]),
        ("mass = 0.25 ", "", ["'mass' is missing in [body]"]),
        ("mass = 0.25 ", "mass = ", ["not valid TOML"]),
        ("mass = 0.25 ", "mass = 250.0", ["weight", "kg"]),
        ("torque_constant =", "thrust_curve = 1.5\ntorque_constant =", ["thrust_curve", "at most 1"]),
    ],
)
def test_a_wrong_file_is_refused_in_words_that_help(old, new, words):
    message = refusal(replaced(old, new))
    assert all(word in message for word in words), message


@pytest.mark.parametrize(
    ("effect", "words"),
    [
        ('name = "rotor_drg"', ["unknown effect 'rotor_drg'", "did you mean 'rotor_drag'", "parasitic_drag"]),
        (
            'name = "rotor_drag"\n[effects.parameters]\ncoeficient = 1e-5',
            ["'coeficient'", "did you mean 'coefficient'"],
        ),
        ('name = "rotor_drag"\n[effects.parameters]\ncoefficient = -1.0', ["-1.0", "outside its bounds [0.0, 0.01]"]),
        ('name = "rotor_drag"\n[effects.parameters]\ncoefficient = nan', ["finite"]),
        ('name = "rotor_drag"\nrotor = 1', ["whole vehicle", "leave rotor out"]),
        ('name = "weak_rotor"', ["one rotor", "rotor = 0 to 3"]),
        ('name = "weak_rotor"\nrotor = 4', ["rotor = 0 to 3, not 4"]),
        ('name = "wind"\nparam = 1', ["unknown key 'param' in [effects]", "did you mean 'parameters'"]),
    ],
)
def test_an_effect_that_cannot_be_is_refused(effect, words):
    message = refusal(with_effect(effect))
    assert all(word in message for word in words), message


def test_an_effect_in_the_file_is_read():
    vehicle = parse_vehicle(with_effect('name = "weak_rotor"\nrotor = 2\n[effects.parameters]\nloss = 0.1'))
    assert vehicle.effects == (EffectUse("weak_rotor", {"loss": 0.1}, 2),)


def test_a_refusal_names_the_file(tmp_path):
    path = tmp_path / "v.toml"
    path.write_text(replaced("mass =", "mas ="))
    with pytest.raises(RequestError, match=re.escape(str(path))):
        read_vehicle(path)


@pytest.mark.parametrize("make", [lambda p: None, lambda p: p.mkdir(), lambda p: p.write_bytes(b"\xff\xfe")])
def test_a_file_that_is_no_text_is_refused(tmp_path, make):
    path = tmp_path / "v.toml"
    make(path)
    with pytest.raises(RequestError, match=r"cannot read the vehicle file|there is no vehicle file"):
        read_vehicle(path)


def test_writing_and_reading_gives_the_same_vehicle(tmp_path, arpl_250g):
    rich = msgspec.structs.replace(
        arpl_250g.with_effects(
            EffectUse("rotor_drag", {"coefficient": 2.2e-5}), EffectUse("weak_rotor", {"loss": 0.1}, 0)
        ),
        limits=Limits(box=((-1.0, -2.0, 0.0), (1.0, 2.0, 3.0)), thrust=(0.1, 4.0)),
        history=(HistoryEntry("2026-01-01", "add rotor_drag", ("a1b2",), {"imu": 1.5}, {"imu": 0.5}, "alula add"),),
    )
    write_vehicle(rich, tmp_path / "v.toml")
    assert read_vehicle(tmp_path / "v.toml") == rich


def test_a_written_file_is_readable_by_others_and_alone(tmp_path, arpl_250g):
    write_vehicle(arpl_250g, tmp_path / "v.toml")
    assert stat.S_IMODE((tmp_path / "v.toml").stat().st_mode) & stat.S_IRUSR
    assert stat.S_IMODE((tmp_path / "v.toml").stat().st_mode) == _usual_mode(tmp_path)
    assert [path.name for path in tmp_path.iterdir() if path.name != "usual"] == ["v.toml"]
    assert tomllib.loads((tmp_path / "v.toml").read_text())["name"] == "arpl_250g"


def _usual_mode(folder):
    (folder / "usual").touch()
    return stat.S_IMODE((folder / "usual").stat().st_mode)


def test_a_vehicle_file_is_never_overwritten(tmp_path, arpl_250g):
    path = tmp_path / "v.toml"
    path.write_text("mine")
    with pytest.raises(RequestError, match="never overwritten; give another name"):
        write_vehicle(arpl_250g, path)
    assert path.read_text() == "mine"


def test_writing_into_a_folder_that_is_not_there_is_refused(tmp_path, arpl_250g):
    with pytest.raises(RequestError, match="cannot write"):
        write_vehicle(arpl_250g, tmp_path / "absent" / "v.toml")


def test_effects_of_a_command_line():
    assert parse_effect("motor_lag", 4) == EffectUse("motor_lag")
    assert parse_effect("wind:x=2,y=-1.5", 4) == EffectUse("wind", {"x": 2.0, "y": -1.5})
    assert parse_effect("weak_rotor:rotor=3,loss=0.2", 4) == EffectUse("weak_rotor", {"loss": 0.2}, 3)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("rotor_drg", "did you mean 'rotor_drag'"),
        ("wind:x", "is not key=number"),
        ("wind:x=fast", "is not key=number"),
        ("wind:q=1", "unknown parameter 'q'"),
        ("wind:x=nan", "outside its bounds"),
        ("wind:x=99", "outside its bounds"),
        ("weak_rotor:loss=0.1", "rotor = 0 to 3"),
        ("weak_rotor:loss=0.1,rotor=1.5", "whole number"),
        ("weak_rotor:loss=0.1,rotor=nan", "whole number"),
        ("weak_rotor:loss=0.1,rotor=-1", "rotor = 0 to 3"),
        ("wind:x=1,rotor=1", "leave rotor out"),
    ],
)
def test_a_wrong_effect_of_a_command_line_is_refused(text, message):
    with pytest.raises(RequestError, match=message):
        parse_effect(text, 4)


@pytest.mark.parametrize("effect", CATALOGUE.values(), ids=CATALOGUE)
def test_every_effect_has_source_units_and_defaults_within_bounds(effect, arpl_250g):
    assert effect.source
    assert effect.summary
    for parameter in effect.parameters:
        assert parameter.unit
        assert parameter.lower < parameter.upper
        assert parameter.prior(arpl_250g).std > 0
        assert parameter.lower <= effect.defaults(arpl_250g)[parameter.name] <= parameter.upper


def test_a_bundled_vehicle_is_read_by_its_name():
    assert find_vehicle("arpl_250g") == FOLDER / "arpl_250g.toml"


def test_anything_else_is_taken_as_a_path(tmp_path, monkeypatch):
    assert find_vehicle("mine.toml") == Path("mine.toml")
    assert find_vehicle("folder/arpl_250g") == Path("folder/arpl_250g")
    monkeypatch.chdir(tmp_path)
    Path("arpl_250g").touch()
    assert find_vehicle("arpl_250g") == Path("arpl_250g")


@pytest.mark.parametrize("text", ["motor_lag", "rotor_drag:coefficient=2.5e-05", "weak_rotor:loss=0.1,rotor=2"])
def test_an_effect_is_written_as_it_is_read(text: str) -> None:
    assert effect_text(parse_effect(text, 4)) == text
