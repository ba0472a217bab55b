"""A residual fades in flight as in training: the ensemble's disagreement by kernel, ONNX, C and torch."""

import dataclasses

import numpy as np
import onnxruntime
import pytest

from dynamics.arrays import Floats
from dynamics.state import RIGID_BODY_STATES
from dynamics.vehicle import Vehicle
from export.bundle import ExportOptions, export_bundle
from export.parity import look_back
from export.symbolic import weighted_function
from export.trained import ExportedModel, exported
from export.windows import random_windows
from runtime.control.bundle import Bundle, read_bundle
from runtime.control.controller import Controller
from runtime.control.rti.processor import native_processor
from runtime.control.rti.solver import RtiSolver
from tests.export.conftest import SHORT, SMALL
from tests.support.trained import replaced, untrained_model
from training.checkpoint import Reliability, TrainedModel
from training.data.features import columns
from training.models import KINDS
from training.prediction import disagreement_of, gate_of

EVEN = np.ones(6)


def ensemble(vehicle: Vehicle, kind: str = "grey_box", limit: float = 1.0) -> TrainedModel:
    """Three members whose residual fades from a limit on."""
    model = untrained_model(replaced(KINDS[kind].config, **SMALL), vehicle, members=3, gain=0.05)
    return dataclasses.replace(model, reliability=Reliability(limit, EVEN, EVEN))


def gates(model: ExportedModel, windows: Floats) -> tuple[Floats, Floats]:
    """By training's own code: disagreement over its limit, and share of the residual, of windows."""
    trained = model.trained
    assert trained is not None
    rows = windows.transpose(0, 2, 1)
    inputs = columns(trained.config, rows[..., :RIGID_BODY_STATES], rows[..., RIGID_BODY_STATES:])
    assert trained.reliability is not None
    disagreement = disagreement_of(trained.outputs(inputs), trained.scaling.output_std)
    limit = trained.reliability.disagreement
    return disagreement / limit, gate_of(disagreement, limit)


def assessed(solver: RtiSolver, windows: Floats, hidden: Floats) -> Floats:
    """(n, 2) what a kernel makes of windows."""
    rows = []
    for window in windows:
        look_back(solver, window)
        solver.assess(np.concatenate([window[:RIGID_BODY_STATES, -1], hidden]), window[RIGID_BODY_STATES:, -1])
        rows.append(solver.certainty.copy())
    return np.array(rows)


@dataclasses.dataclass(frozen=True)
class Made:
    """A grey box's bundle, of whose random windows half are beyond the limit."""

    model: ExportedModel
    bundle: Bundle

    @property
    def windows(self) -> Floats:
        """(60, 13 + rotors, T)."""
        return random_windows(self.model, 60, 1)

    def solver(self) -> RtiSolver:
        """As the runtime makes it."""
        return RtiSolver(self.bundle.model, self.bundle.manifest.problem, self.bundle.kernel)


@pytest.fixture(scope="module")
def made(lagging: Vehicle, tmp_path_factory: pytest.TempPathFactory) -> Made:
    probe = exported(ensemble(lagging))
    limit = float(np.median(gates(probe, random_windows(probe, 60, 1))[0]))
    model, folder = exported(ensemble(lagging, limit=limit)), tmp_path_factory.mktemp("fading") / "bundle"
    export_bundle(model, folder, ExportOptions(SHORT, native_processor(), windows=30))
    return Made(model, read_bundle(folder))


def test_the_kernel_fades_as_training_does(made: Made) -> None:
    uncertainty, share = gates(made.model, made.windows)
    kernel = assessed(made.solver(), made.windows, made.model.flight_model.hidden_initial)
    np.testing.assert_allclose(kernel[:, 0], uncertainty, rtol=1e-4)
    np.testing.assert_allclose(kernel[:, 1], share, rtol=2e-4)
    assert 0.3 < np.mean(share < 1) < 0.7
    assert (made.bundle.manifest.fades, made.bundle.manifest.members) == (True, 3)


def test_onnx_has_the_same_uncertainty(made: Made) -> None:
    session = onnxruntime.InferenceSession(str(made.bundle.folder / "model.onnx"), providers=["CPUExecutionProvider"])
    hidden = np.tile(made.model.flight_model.hidden_initial, (60, 1)).astype(np.float32)
    (uncertainty,) = session.run(["uncertainty"], {"history": made.windows.astype(np.float32), "hidden": hidden})
    np.testing.assert_allclose(uncertainty[:, 0], gates(made.model, made.windows)[0], rtol=1e-4)


def test_predictions_have_the_share_until_the_next_assessment(made: Made) -> None:
    """All of the residual at first, the faded one afterwards, all again after a reset."""
    model, windows, solver = made.model, made.windows, made.solver()
    window = windows[np.argmax(gates(model, windows)[0])]
    state = np.concatenate([window[:RIGID_BODY_STATES, -1], model.flight_model.hidden_initial])
    speed = window[RIGID_BODY_STATES:, -1]
    look_back(solver, window)
    complete = solver.accelerations(state, speed)
    solver.assess(state, speed)
    faded, share = solver.accelerations(state, speed), float(solver.certainty[1])
    solver.reset(state)
    np.testing.assert_array_equal(solver.accelerations(state, speed), complete)
    base = np.array(weighted_function(model)(window, state[RIGID_BODY_STATES:], 0.0)[0]).ravel()
    assert share < 0.7
    np.testing.assert_allclose(faded - base, share * (complete - base), atol=1e-4)
    assert np.abs(complete - faded).max() > 0.01


def test_a_network_without_a_base_does_not_fade(lagging: Vehicle) -> None:
    model = exported(ensemble(lagging, "pi_tcn"))
    assert model.ensemble is not None
    assert not model.ensemble.fades


def test_a_network_that_was_trained_alone_does_not_know(lagging: Vehicle) -> None:
    assert exported(untrained_model(replaced(KINDS["grey_box"].config, **SMALL), lagging)).ensemble is None


def test_where_the_residual_has_faded_nothing_is_left_to_fall_back_from(made: Made) -> None:
    """An input outside of its training range counts while the network is flown, and not once it has faded."""
    controller = Controller.from_bundle(made.bundle)
    state = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, *[0.0] * 6])
    controller.reset(state, 0.0)
    assert controller.network_share == 1
    spinning = state.copy()
    spinning[10] = 60.0
    controller.compensate(spinning, 0.01, 0.01)
    assert "rate_x is 60" in controller.model_faults(0.01)[1]
    controller.prepare(
        np.tile(state, (SHORT.nodes + 1, 1)), np.tile(controller.solver.trim.rotor_speed, (SHORT.nodes, 1))
    )
    assert controller.network_share < 0.5
    assert controller.uncertainty > 1
    assert controller.model_faults(0.01)[1:] == ("", "")
