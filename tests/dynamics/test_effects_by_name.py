"""No room asks for an effect of the catalogue by its name: what it needs stands in the effect."""

import ast
from pathlib import Path

import pytest

from alula.rooms import ROOMS
from dynamics.effects import CATALOGUE

ROOT = Path(__file__).parents[2]
LIBRARY = sorted({"alula", *ROOMS} - {"vehicles"})  # vehicles is data

# Words that are an effect's name as well, and what they are there.
ALLOWED = {
    "alula/cli/vehicle.py": {"mass"},  # a part's number and its option
    "diagnosis/vehicle_from_logs.py": {"mass"},  # the same
    "diagnosis/vehicle_identification.py": {"thrust_constant", "torque_constant"},  # fields of a vehicle's rotors
    "dynamics/vehicle_plausibility.py": {"mass"},  # a field of the vehicle's body
    "diagnosis/data/inspected.py": {"rotor_speed_fault"},  # the name of a finding
    "dynamics/model.py": {"mass", "thrust_constant", "centre_of_mass"},  # outputs of the model's constants
    "dynamics/references/campaign.py": {  # what the example campaign hides: a user's configuration
        "motor_lag", "rotor_drag", "parasitic_drag", "blade_flapping", "axial_inflow", "translational_lift",
        "thrust_constant", "inertia", "gust",
    },
    "flights/readers/blackbox_fields.py": {"gyro_scale"},  # a key of a blackbox header
    "flights/quality/rotor_balance.py": {"rotor_speed_fault"},  # the name of a finding in reports
    "runtime/control/rti/last_setpoint.py": {"mass"},  # a field of the C struct
    "runtime/control/rti/problem.py": {"thrust_constant"},  # a field of the C struct
    "sitl_mock/vehicle/plant.py": {"torque_constant", "gyro_bias"},  # constants of the mock's own sensors and battery
    "sitl_mock/vehicle/sensors.py": {"gyro_bias"},
    "sitl_mock/vehicle/vehicle.py": {"torque_constant"},
    "studio/app/opened.py": {"mass"},  # a field of a form
    "studio/work/making.py": {"mass"},  # the same field, in the request that it becomes
    "studies/demo/flights.py": {"rotor_drag", "parasitic_drag"},  # what the demo hides by default
    "studies/sweep/catalogue.py": {"inertia"},  # a study's name
    "studies/sweep/cell.py": {"mass"},  # a field of the vehicle's body
    "studies/sweep/figures.py": {"inertia"},
}  # fmt: skip


def names_in(tree: ast.AST) -> set[str]:
    """Effects that string literals name, alone or as an effect is written on a command line, `name:key=value`."""
    docstrings = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    literals = [node for node in ast.walk(tree) if isinstance(node, ast.Constant) and id(node) not in docstrings]
    return {node.value.split(":")[0] for node in literals if isinstance(node.value, str)} & set(CATALOGUE)


@pytest.mark.parametrize("room", LIBRARY)
def test_no_effect_is_asked_for_by_name(room: str) -> None:
    for path in (ROOT / room).rglob("*.py"):
        place = path.relative_to(ROOT).as_posix()
        if not place.startswith("dynamics/effects/"):
            named = names_in(ast.parse(path.read_text(encoding="utf-8")))
            assert named <= ALLOWED.get(place, set()), place


def test_every_file_with_an_exception_still_needs_one() -> None:
    for place, allowed in ALLOWED.items():
        assert names_in(ast.parse((ROOT / place).read_text(encoding="utf-8"))) & allowed, place
