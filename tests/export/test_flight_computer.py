"""A bundle flies on a computer without CasADi, without a compiler and without the workbench, as it does here."""

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from dynamics.trust import approve_given
from dynamics.vehicle import EffectUse, Vehicle
from dynamics.vehicle_file import parse_vehicle, vehicle_toml, with_effect_files
from export.bundle import Exported, ExportOptions, export_bundle
from export.trained import read_model
from runtime.control.rti.problem import Problem
from runtime.control.rti.processor import native_processor

FLY = """
import os, sys
from pathlib import Path
for name in sys.argv[2:]:
    sys.modules[name] = None
    os.environ["PATH"] = ""
from runtime.control.controller import ControllerOptions
from runtime.flight.composition import build_controllers, warm_up
from runtime.flight_setup import FlightSetup, prepare_flight
flight = prepare_flight(FlightSetup(link="udpin:127.0.0.1:14540", reference="hover:laps=1", bundle=Path(sys.argv[1])))
controllers = build_controllers(flight.vehicle, flight.bundle, ControllerOptions.for_vehicle(flight.vehicle))
warm_up(controllers, flight.reference, flight.request.plan, rate=flight.request.rate)
print(*(one.solver.inputs.tobytes().hex() for one in controllers if one is not None))
"""
OWN_EFFECT = """
import casadi as ca
from dynamics.effect import Effect, Parameter, Prior, Wrench
EFFECT = Effect(
    name="tail_push", summary="A force to the back", source="made up",
    parameters=(Parameter("force", "N", "force", 0.0, 1.0, lambda vehicle: Prior(0.1, 0.1)),),
    wrench=lambda c, p, x: Wrench(ca.vertcat(-p["force"], 0, 0.01 * ca.sum1(c.rotor_thrust)), ca.SX.zeros(3)),
)
"""
ABSENT = ("casadi", "scipy", "torch", "onnx", "onnxruntime", "matplotlib", "pandas", "pyarrow")


def flown(bundle: Path, *absent: str) -> str:
    done = subprocess.run(
        [sys.executable, "-c", FLY, str(bundle), *absent], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.parametrize("kind", ["nominal", "grey_box"])
def test_a_bundle_flies_bit_for_bit_without_casadi_and_a_compiler(
    export_kind: Callable[[str], Exported], kind: str
) -> None:
    folder = export_kind(kind).folder
    assert flown(folder, *ABSENT) == flown(folder)


def test_a_bundle_with_an_effect_of_ones_own_flies_without_casadi(arpl_250g: Vehicle, tmp_path: Path) -> None:
    (tmp_path / "own.py").write_text(OWN_EFFECT)
    approve_given([tmp_path / "own.py"])
    text = with_effect_files(vehicle_toml(arpl_250g), tmp_path, [tmp_path / "own.py"])
    vehicle = parse_vehicle(text).with_effects(EffectUse("tail_push", {"force": 0.05}))
    (tmp_path / "v.toml").write_text(vehicle_toml(vehicle))
    options = ExportOptions(Problem(nodes=5, horizon=0.25), native_processor(), windows=10)
    export_bundle(read_model(tmp_path / "v.toml"), tmp_path / "bundle", options)
    assert flown(tmp_path / "bundle", *ABSENT) == flown(tmp_path / "bundle")
