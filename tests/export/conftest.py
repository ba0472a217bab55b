"""Bundles of small models, exported once."""

from collections.abc import Callable
from pathlib import Path

import pytest

from dynamics.vehicle import EffectUse, Vehicle
from export.bundle import Exported, ExportOptions, export_bundle
from export.trained import exported
from runtime.control.rti.problem import Problem
from runtime.control.rti.processor import native_processor
from tests.support.trained import replaced, untrained_model
from training.models import KINDS

SHORT = Problem(nodes=5, horizon=0.25)
SMALL = {"channels": 8, "hidden": (16,)}


@pytest.fixture(scope="session")
def lagging(arpl_250g: Vehicle) -> Vehicle:
    """The paper's quadrotor with motor lag and rotor drag in its file."""
    return arpl_250g.with_effects(EffectUse("motor_lag", {"time_constant": 0.03}), EffectUse("rotor_drag"))


@pytest.fixture(scope="session")
def export_kind(tmp_path_factory: pytest.TempPathFactory, lagging: Vehicle) -> Callable[[str], Exported]:
    """Exports a small model of a kind, or gives the bundle that it made before."""
    folder, made = tmp_path_factory.mktemp("bundles"), dict[str, Exported]()

    def export(kind: str) -> Exported:
        if kind not in made:
            config = replaced(KINDS[kind].config, **SMALL)
            if kind == "mse_tcn":  # as the paper has it
                config = replaced(config, inputs="world", outputs="world", batch_norm=True)
            options = ExportOptions(SHORT, native_processor(), windows=50, command=f"alula export {kind}.pt")
            made[kind] = export_bundle(exported(untrained_model(config, lagging)), folder / kind, options)
        return made[kind]

    return export


@pytest.fixture
def bundle_folder(export_kind: Callable[[str], Exported]) -> Path:
    """A PI-TCN's bundle, which tests must not change."""
    return export_kind("pi_tcn").folder
