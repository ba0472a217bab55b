"""Accelerations become motion as their labels ask for, and what cannot work is refused with what to do."""

from pathlib import Path

import pytest

from dynamics.errors import RequestError
from dynamics.vehicle import Vehicle
from export.bundle import Exported, ExportOptions, export_bundle
from export.trained import exported
from runtime.control.bundle import Integrator, read_bundle
from runtime.control.rti.processor import native_processor
from runtime.control.rti.solver import RtiSolver
from tests.export.conftest import SHORT
from tests.support.trained import replaced, untrained_model
from training.models import KINDS

SMALL = {"channels": 8, "hidden": (16,), "label": "instantaneous"}


def made(vehicle: Vehicle, folder: Path, kind: str, integrator: Integrator | None, **overrides: object) -> Exported:
    config = replaced(KINDS[kind].config, **(SMALL | overrides))
    model = exported(untrained_model(config, vehicle), integrator=integrator)
    return export_bundle(model, folder / "b", ExportOptions(SHORT, native_processor(), windows=30))


@pytest.mark.parametrize(
    ("kind", "requested", "chosen", "columns", "precision"),
    [
        ("mse_tcn", None, "adams_bashforth", 19, "float"),
        ("pi_mlp", None, "adams_bashforth", 1, "float"),
        ("pi_mlp", "rk4", "rk4", 0, "double"),
        ("grey_box", None, "adams_bashforth", 19, "float"),
    ],
)
def test_instantaneous_accelerations_are_integrated_and_every_kernel_is_proven_to_do_so(
    lagging: Vehicle, tmp_path: Path, kind: str, requested: Integrator | None, chosen: str, columns: int, precision: str
) -> None:
    bundle = made(lagging, tmp_path, kind, requested)
    manifest = read_bundle(bundle.folder).manifest
    assert (manifest.integrator, manifest.precision, manifest.label) == (chosen, precision, "instantaneous")
    proven = {comparison.backend for comparison in bundle.parity.comparisons}
    assert {"kernel, double: roll-out", "kernel, double: gradient", "torch, double", "CasADi C, double"} <= proven
    read = read_bundle(bundle.folder)
    assert len(RtiSolver(read.model, manifest.problem, read.kernel).history) == columns


def test_rk4_on_a_residual_carries_the_hidden_states_of_its_physics(lagging: Vehicle, tmp_path: Path) -> None:
    bundle = made(lagging, tmp_path, "grey_box", "rk4", network="mlp", history=1)
    assert read_bundle(bundle.folder).model.hidden_count == 4
    assert all(comparison.holds for comparison in bundle.parity.comparisons)


@pytest.mark.parametrize(
    ("kind", "label", "requested", "message"),
    [
        ("pi_tcn", "instantaneous", "rk4", r"between the 20 columns.*adams_bashforth"),
        ("window_mlp", "instantaneous", "rk4", r"between the 20 columns.*without history"),
        ("pi_mlp", "mean_increment", "rk4", r"mean accelerations over the next 10 ms.*--label instantaneous"),
        ("pi_tcn", "mean_increment", "adams_bashforth", r"which are held, not integrated"),
        ("nominal", "mean_increment", "hold", r"physical model, which is integrated by rk4"),
    ],
)
def test_a_scheme_that_does_not_fit_is_refused(
    lagging: Vehicle, kind: str, label: str, requested: Integrator, message: str
) -> None:
    trained = untrained_model(replaced(KINDS[kind].config, label=label), lagging)
    with pytest.raises(RequestError, match=message):
        exported(trained, integrator=requested)


def test_holding_instantaneous_accelerations_is_allowed_with_a_note(lagging: Vehicle, tmp_path: Path) -> None:
    bundle = made(lagging, tmp_path, "pi_mlp", "hold")
    assert any("adams_bashforth predicts better" in note for note in bundle.manifest.notes)


def test_a_model_on_filtered_inputs_is_exported_for_the_workbench_and_does_not_fly(
    lagging: Vehicle, tmp_path: Path
) -> None:
    bundle = made(
        lagging,
        tmp_path,
        "pi_tcn",
        None,
        inputs="world",
        outputs="world",
        motors="measured",
        filtered_inputs=True,
        batch_norm=True,
        dropout=0.1,
    )
    assert all(comparison.holds for comparison in bundle.parity.comparisons)
    assert any("measured rotor speeds" in note for note in bundle.manifest.notes)
    with pytest.raises(RequestError, match=r"filtered with their future.*--causal-inputs"):
        read_bundle(bundle.folder)
