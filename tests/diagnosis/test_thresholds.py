"""Every threshold has an origin, is read from TOML within its bounds, and is the one that decides."""

import ast
import re
from pathlib import Path

import msgspec
import pytest

import diagnosis
from diagnosis.data.dataset import Dataset
from diagnosis.diagnose import diagnose_dataset
from diagnosis.thresholds import DEFAULT, Thresholds
from diagnosis.thresholds_file import read_thresholds
from dynamics.effects import CATALOGUE
from dynamics.errors import DataError, RequestError
from tests.diagnosis.synthetic import hovering

ROOM = Path(diagnosis.__file__).parent
SOME = {name: CATALOGUE[name] for name in ("mass", "thrust_constant", "imu_bias", "gyro_bias")}
# Sizes and places of arrays, units, a seed, how many rows fit the cache, effects: nothing that a fleet would retune.
NO_THRESHOLDS = {
    "DEGREES", "OUTPUTS", "OF_VELOCITY", "OF_ATTITUDE", "OF_RATE", "START", "BLOCK", "AXES", "SPECIFIC_FORCE",
    "POSE_ACCELERATION", "ANGULAR_ACCELERATION", "ATTITUDE_RATE", "MOTION", "POSE_AND_VELOCITY", "PARAMETERS",
    "PERIOD", "SEED", "FORCE_READING", "RATE_READING", "POSE_AGE", "ENVIRONMENT", "BATTERY",
    "ATTITUDE_AGE", "POSE_ARM", "BY_MEANS", "TURNED",
    "MAX_TURN",  # of a frame's rotors, which no verdict sees
    "GYRO_AXES", "GAIN", "GAIN_KEY", "MASS_KEY", "MOTOR", "BEND", "MAX_ADVICE", "DAMPING", "NORMAL",
    # sizes of blocks and caches, which change no number
    "CHAINED_BLOCK", "FEW", "MAX_FOLLOWED", "MAX_KEPT", "MAX_MOVED", "LANES",
    "TINY", "STILL",  # instead of nothing
    "NEGLECTED",  # a filter's response is cut at rounding
    "MOSTLY",  # a probability that is not written as 100 %
    "NODES", "RIGID", "STEP", "LAG_STEP", "SMALL", "SPEEDS", "DOUBLINGS", "MAX_SAVED",  # of arrays, differences, series
    "MAX_STEP", "FIRST_DAMPING", "MAX_DAMPING",  # of scoring, which ends at the same optimum
    "PARAMETER_STEP", "START_STEP", "BETWEEN",  # of hidden states: differences, points between a grid's
    "BEFORE_READING",  # where a line has its mean effect
    "MIN_BLOCKS", "PASSES",  # of a held-out score: a deviation needs two, a reference two
    "CHANNELS", "FINE", "SPECTRUM_ROWS",  # of arrays; of a periodogram that is interpolated, or shown
    "FREQUENCIES", "AGREEMENT",  # a component of noise and its own spectrum, to rounding
}  # fmt: skip


def groups():
    return [(field.name, field.type) for field in msgspec.structs.fields(Thresholds)]


@pytest.mark.parametrize(("name", "group"), groups(), ids=[name for name, _ in groups()])
def test_every_threshold_has_a_line_with_its_origin(name, group):
    lines = re.sub(r"\n {8,}|(?<=[^\]\n])\n {4}(?=\S)", " ", group.__doc__)
    for field in msgspec.structs.fields(group):
        assert re.search(rf"(?m)^ *{field.name}: .*\[[^\]]+\]$", lines), f"{name}.{field.name}"


def test_no_numeric_constant_of_a_module_is_outside():
    outside = set()
    for path in ROOM.rglob("*.py"):
        # a manoeuvre decides no verdict; a component of noise holds its priors, as an effect its bounds
        if path.parent.name in ("thresholds", "experiment", "components") or path.name == "priors.py":
            continue
        for node in ast.parse(path.read_text()).body:
            if isinstance(node, ast.Assign) and any(
                isinstance(part, ast.Constant) and type(part.value) in (int, float) for part in ast.walk(node.value)
            ):
                targets = [part for target in node.targets for part in ast.walk(target)]
                outside |= {part.id for part in targets if isinstance(part, ast.Name) and part.id.isupper()}
    assert outside <= NO_THRESHOLDS, outside - NO_THRESHOLDS


def test_a_file_changes_what_it_names_and_leaves_the_rest(tmp_path):
    file = tmp_path / "fleet.toml"
    file.write_text("[likelihood]\nnamed = 4\n[data_checks]\nthrust_ratio = [0.5, 2.0]\n")
    read = read_thresholds(file)
    assert read.likelihood.named == 4.0
    assert read.data_checks.thrust_ratio == (0.5, 2.0)
    assert read.pose == DEFAULT.pose
    file.write_text("")
    assert read_thresholds(file) == DEFAULT


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("[likelihood]\nnamde = 4", "unknown key 'namde' in \\[likelihood\\]"),
        ("[likelyhood]\nnamed = 4", "unknown key 'likelyhood'"),
        ("[likelihood]\nform = 1.5", "likelihood.form must be a number at most 1.0"),
        ("[filters]\ncutoff = 0", "filters.cutoff must be a number above 0.0"),
        ("[filters]\nrate = 12", "filters: .* below half the rate 6 Hz"),
        ("[regimes]\nbins = 1", "regimes.bins must be a whole number at least 2"),
        ("[likelihood]\namplitude = [1.9, 0.4]", "the first must be below the second"),
        ("[regimes]\nquantiles = [0.01, 1.99]", "quantiles\\[1\\] must be a number at most 1.0"),
        (
            "[command_curve]\ncommand_percentiles = [1.0, 199.0]",
            "percentiles\\[1\\] must be a number at most 100.0",
        ),
        ("[likelihood]\nnamed = 'high'", "likelihood.named holds a text; wanted is a number"),
        ("[search", "cannot use the thresholds"),
    ],
)
def test_a_file_that_is_wrong_is_refused_with_the_bound(tmp_path, text, reason):
    file = tmp_path / "fleet.toml"
    file.write_text(text)
    with pytest.raises(RequestError, match=reason):
        read_thresholds(file)


def test_a_file_that_is_not_there_is_refused(tmp_path):
    with pytest.raises(RequestError, match="cannot use the thresholds"):
        read_thresholds(tmp_path / "none.toml")


@pytest.fixture(scope="module")
def heavy(arpl_250g):
    fitted = hovering(arpl_250g, mass_ratio=1.05, seed=4, count=4)
    return Dataset(fitted, (0, 1, 2, 3), hovering(arpl_250g, mass_ratio=1.05, seed=5, count=2), {}, ())


@pytest.fixture(scope="module")
def answer(heavy, arpl_250g):
    """The diagnosis with some thresholds replaced, by group."""

    def make(**changed):
        groups = {name: msgspec.structs.replace(getattr(DEFAULT, name), **fields) for name, fields in changed.items()}
        return diagnose_dataset(heavy, arpl_250g, SOME, msgspec.structs.replace(DEFAULT, **groups)).diagnosis

    return make


@pytest.fixture(scope="module")
def usual(answer):
    return answer()


def test_by_default_the_mass_is_named(usual):
    assert {usual.effects[0].name, *usual.effects[0].ambiguous_with} == {"mass", "thrust_constant"}
    assert usual.verdict == "ambiguous"


def test_higher_odds_that_are_required_name_nothing(answer):
    higher = answer(likelihood={"named": 700.0})
    assert higher.effects == ()
    assert "unsure" in {one.reason for one in higher.refused}


def test_a_higher_limit_on_cells_names_no_failing_regime(answer, usual):
    assert usual.fails_where
    assert answer(regimes={"min_failing": 1e6}).fails_where == ()


def test_a_longer_minimum_duration_refuses_the_flights(answer):
    with pytest.raises(DataError, match="too short"):
        answer(data_checks={"min_duration": 1e4})


@pytest.mark.parametrize(
    ("name", "accepted"),
    [
        ("inertia", DEFAULT.rotor_moments.angular_ratio),
        ("mass", DEFAULT.data_checks.thrust_ratio),
        ("thrust_constant", DEFAULT.data_checks.thrust_ratio),
    ],
)
def test_what_the_checks_of_logs_accept_is_within_the_bounds_of_the_effect_that_explains_it(name, accepted):
    for parameter in CATALOGUE[name].parameters:
        assert parameter.lower <= accepted[0]
        assert parameter.upper >= accepted[1]
