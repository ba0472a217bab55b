"""What a wheel carries flies the bundled vehicles, and others without effects, without CasADi and a compiler."""

import shutil
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest

from dynamics.errors import RequestError
from dynamics.vehicle import EffectUse, Vehicle
from dynamics.vehicle_file import read_vehicle
from export import prebuilt
from runtime.control.controller import Controller
from runtime.control.kernel_model import KernelModel
from runtime.control.rti.processor import PROCESSORS, native_processor
from vehicles import FOLDER


@pytest.fixture(scope="module")
def px4_sih() -> Vehicle:
    return read_vehicle(FOLDER / "px4_sih.toml")


@pytest.fixture(scope="module")
def kernels(px4_sih: Vehicle, arpl_250g: Vehicle, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Solvers of two bundled vehicles for this processor."""
    folder, processor = tmp_path_factory.mktemp("kernels"), native_processor()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(prebuilt, "PROCESSORS", {processor.name: replace(processor, name="this")})
        patch.setattr(prebuilt, "_vehicles", lambda: iter((px4_sih, arpl_250g)))
        prebuilt.build_prebuilt(processor.machine, folder)
    return folder


@pytest.fixture
def flight_computer(kernels: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An install of the wheel, without CasADi and without a compiler."""
    monkeypatch.setattr("runtime.control.rti.prebuilt.FOLDER", kernels)
    monkeypatch.setattr("runtime.control.rti.prebuilt.PROCESSORS", {"this": replace(native_processor(), name="this")})
    monkeypatch.setattr("dynamics.symbolic.is_installed", lambda: False)
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setenv("ALULA_CACHE", str(tmp_path))
    monkeypatch.delenv("CC", raising=False)


def first_command(controller: Controller) -> np.ndarray:
    """After a tick half a metre away from where it has to be."""
    state = np.array([0.5, 0.0, 1.0, *[0.0] * 3, 1.0, *[0.0] * 6])
    controller.reset(state, 0.0)
    states = np.tile(np.array([0.0, 0.0, 1.0, *[0.0] * 3, 1.0, *[0.0] * 6]), (controller.options.problem.nodes + 1, 1))
    controller.prepare(states, np.full((len(states) - 1, 4), controller.trim.hover_speed))
    return controller.feedback(controller.compensate(state, 0.0, 0.0), 0.0).rotor_speed


@pytest.mark.parametrize("name", ["px4_sih", "arpl_250g"])
@pytest.mark.usefixtures("flight_computer")
def test_a_bundled_vehicle_flies_as_where_it_is_compiled(
    name: str, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest
) -> None:
    vehicle = request.getfixturevalue(name)
    light = Controller.build(vehicle)
    assert isinstance(light.model, KernelModel)
    command = first_command(light)
    monkeypatch.undo()
    np.testing.assert_allclose(command, first_command(Controller.build(vehicle)), rtol=1e-6)


@pytest.mark.usefixtures("flight_computer")
def test_another_vehicle_without_effects_flies_too(arpl_250g: Vehicle) -> None:
    heavier = msgspec.structs.replace(arpl_250g, body=msgspec.structs.replace(arpl_250g.body, mass=0.3), name="mine")
    assert np.isfinite(first_command(Controller.build(heavier))).all()


@pytest.mark.usefixtures("flight_computer")
def test_a_vehicle_with_other_effects_is_refused_with_what_to_do(arpl_250g: Vehicle) -> None:
    with pytest.raises(
        RequestError, match=r"effects of arpl_250g need CasADi.*--bundle.*pip install '.*\[workbench\]'"
    ):
        Controller.build(arpl_250g.with_effects(EffectUse("rotor_drag")))


@pytest.mark.usefixtures("flight_computer")
def test_another_horizon_is_refused_with_what_to_do(arpl_250g: Vehicle) -> None:
    controller = msgspec.structs.replace(arpl_250g.controller, nodes=13)
    with pytest.raises(RequestError, match=r"no compiled controller of arpl_250g with 13 nodes.*--bundle"):
        Controller.build(msgspec.structs.replace(arpl_250g, controller=controller))


@pytest.mark.skipif(shutil.which("aarch64-linux-gnu-gcc") is None, reason="no aarch64-linux-gnu-gcc")
def test_solvers_for_another_machine_are_cross_compiled_and_need_no_library_beside_them(
    arpl_250g: Vehicle, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(prebuilt, "_vehicles", lambda: iter((arpl_250g,)))
    made = prebuilt.build_prebuilt(PROCESSORS["neon"].machine, tmp_path)
    assert [path.name for path in made] == ["neon-4_rotors-20.so", "tick.so", "facts.json"]
