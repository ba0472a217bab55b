"""A network's last layer follows in flight: the kernel flies its change, shadow flies as without, replays are exact."""

import dataclasses

import numpy as np
import pytest

from dynamics.errors import RequestError
from dynamics.model import build_model
from dynamics.references import named_reference
from dynamics.vehicle import EffectUse, Vehicle
from export.bundle import ExportOptions, export_bundle
from export.kernel import kernel_solver
from export.network import Dense
from export.trained import exported
from runtime.control.adaptation_settings import AdaptationSettings, Mode, NetworkSettings
from runtime.control.bundle import Bundle, read_bundle
from runtime.control.controller import Controller, ControllerOptions
from runtime.control.rti.problem import Problem
from runtime.control.rti.processor import native_processor
from runtime.flight.composition import Controllers, warm_up
from runtime.flight.mission import Plan
from runtime.flight.phases import Phase
from runtime.flight_setup import FlightSetup, prepare_flight
from simulation.lockstep import FlownReference, fly_reference
from tests.export.test_kernel import CASES, SHORT, VEHICLES, copied, solver_of
from tests.support.rate_controlled_vehicle import Flight
from tests.support.trained import replaced, untrained_model
from training.models import KINDS


@pytest.mark.parametrize("case", ["body", "world", "residual on lag and drag"])
def test_a_changed_kernel_is_that_of_changed_weights(case: str) -> None:
    """Roll-out, gradient and Hessian, by a kernel that was compiled with the weights."""
    network, effects = CASES[case]
    solver, state = solver_of(case, "double")
    change = 0.1 * np.random.default_rng(1).normal(size=solver.output_change.shape)
    last = network.perceptron[-1]
    moved = change / network.output_std[:, None]
    dense = Dense(last.weight + moved[:, :-1], last.bias + moved[:, -1])
    other = dataclasses.replace(network, perceptron=(*network.perceptron[:-1], dense))
    model = build_model(VEHICLES[network.rotors], effects=effects)
    expected = copied(solver, kernel_solver(other, model, SHORT, native_processor(), "double"))
    solver.output_change[:] = change
    solver.assess(state, solver.inputs[0])
    for each in (solver, expected):
        assert each.prepare(state) == 0
    np.testing.assert_allclose(solver.states, expected.states, rtol=0, atol=1e-9)
    np.testing.assert_allclose(solver.gradient, expected.gradient, rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(solver.hessian, expected.hessian, rtol=1e-7, atol=1e-9)
    solver.reset(state)
    assert not solver.output_change.any()


@pytest.fixture(scope="module")
def bundle(tmp_path_factory: pytest.TempPathFactory, arpl_250g: Vehicle) -> Bundle:
    """A residual on the nominal model whose output is nearly zero, and whose features vary with the flight."""
    config = replaced(KINDS["res_tcn"].config, channels=8, hidden=(16,))
    model = untrained_model(config, arpl_250g, gain=0.002)
    moment = np.diag(np.r_[np.full(16, 2.0), 1.0])
    folder = tmp_path_factory.mktemp("bundle") / "b"
    options = ExportOptions(Problem(), native_processor(), windows=20)
    return read_bundle(export_bundle(exported(dataclasses.replace(model, moments=(moment,))), folder, options).folder)


def options_of(bundle: Bundle, network: Mode, mode: Mode = "on") -> ControllerOptions:
    settings = AdaptationSettings(mode=mode, network=NetworkSettings(mode=network))
    return ControllerOptions.for_vehicle(bundle.vehicle, adaptation=settings)


def flown(bundle: Bundle, network: Mode) -> tuple[FlownReference, Controller]:
    """A fast flight of a vehicle with drags that neither network nor file has."""
    options = options_of(bundle, network)
    controller = Controller.from_bundle(bundle, options)
    hidden = EffectUse("rotor_drag", {"coefficient": 2.2e-5}), EffectUse("parasitic_drag", {"coefficient": 0.02})
    reference = named_reference("Ellipse_1", controller.trim, duration=8.0)
    nominal = Controller.fallback_from_bundle(bundle, options)
    return (
        fly_reference(bundle.vehicle, reference, effects=hidden, seed=3, controller=controller, nominal=nominal),
        controller,
    )


def test_a_shadow_flies_as_without_and_forecasts_better_with_the_change(bundle: Bundle) -> None:
    (off, _), (shadow, controller) = flown(bundle, "off"), flown(bundle, "shadow")
    assert shadow.position_rmse == off.position_rmse
    assert controller.adaptation is not None
    layer = controller.adaptation.network
    assert layer is not None
    assert np.linalg.norm(layer.change, axis=1).max() > 0.05
    assert not controller.solver.output_change.any()


def test_what_follows_is_flown_and_no_worse(bundle: Bundle) -> None:
    off, (on, controller) = flown(bundle, "off")[0], flown(bundle, "on")
    assert controller.solver.output_change[:3].any()
    assert not controller.solver.output_change[3:].any()  # the rate loop has the moments
    assert on.fallbacks == 0
    assert on.position_rmse < 1.03 * off.position_rmse


def test_a_flight_whose_network_follows_repeats_bit_for_bit(bundle: Bundle) -> None:
    def begun() -> Flight:
        options = options_of(bundle, "on")
        controller, nominal = (
            make(bundle, options) for make in (Controller.from_bundle, Controller.fallback_from_bundle)
        )
        assert controller is not None
        return Flight(controller.trim, controller, named_reference("circle:laps=1", controller.trim), nominal=nominal)

    flight = begun()
    controllers = Controllers(flight.flyer.controllers.main, flight.flyer.controllers.nominal)
    warm_up(controllers, named_reference("circle:laps=1", controllers.flying.trim), Plan(), rate=100.0)
    again = begun().flyer  # which nothing has warmed up
    flight.plant.disturbance[:] = 0.5, -0.3, 0.0
    flight.run(12.0)
    for (observation, estimate), before in zip(flight.story.observations, flight.story.decisions, strict=True):
        decision = again.step(observation, estimate)
        again.prepare(observation.time)
        np.testing.assert_array_equal(decision.rate_body, before.rate_body)
    own, repeated = (flyer.controllers.adaptation for flyer in (flight.flyer, again))
    assert own is not None
    assert repeated is not None
    assert own.network is not None
    assert repeated.network is not None
    assert own.network.change.any()
    np.testing.assert_array_equal(own.network.change, repeated.network.change)


def test_estimates_that_jump_stop_or_lie_leave_it_bounded(bundle: Bundle) -> None:
    """Setpoints stay finite, and the change within its bounds; `Flight` refuses any other setpoint."""
    options = options_of(bundle, "on")
    controller, nominal = Controller.from_bundle(bundle, options), Controller.fallback_from_bundle(bundle, options)
    flight = Flight(controller.trim, controller, named_reference("circle:laps=2", controller.trim), nominal=nominal)
    flight.run(30.0, until=Phase.TRACK)
    flight.run(2.0)
    for error in (0.6, -0.6, 0.0):
        lie = np.r_[np.zeros(3), error, -error, 0.5 * error, np.zeros(3)]
        flight.estimate_error = lambda _, lie=lie: lie  # type: ignore[misc]
        flight.run(0.3)
    flight.frozen = True
    flight.run(0.25)
    flight.frozen = False
    flight.run(2.0)
    assert controller.adaptation is not None
    layer = controller.adaptation.network
    assert layer is not None
    assert np.linalg.norm(layer.change, axis=1).max() <= layer.settings.network.bound
    assert np.isfinite(controller.solver.output_change).all()
    assert flight.flyer.engagement.flying


@pytest.mark.parametrize(
    ("adapt", "network", "message"),
    [("off", "on", "--network on needs --adapt on"), ("shadow", "on", "--network on needs --adapt on")],
)
def test_it_needs_a_model_that_follows(bundle: Bundle, adapt: Mode, network: Mode, message: str) -> None:
    setup = FlightSetup("udpin:127.0.0.1:14999", "circle", bundle=bundle.folder, adapt=adapt, network=network)
    with pytest.raises(RequestError, match=message):
        prepare_flight(setup)


def test_it_needs_a_network(arpl_250g: Vehicle) -> None:
    setup = FlightSetup("udpin:127.0.0.1:14999", "circle", vehicle=arpl_250g, adapt="on", network="on")
    with pytest.raises(RequestError, match="has no network"):
        prepare_flight(setup)


def test_a_bundle_that_can_estimates_the_change_by_default(bundle: Bundle) -> None:
    setup = FlightSetup("udpin:127.0.0.1:14999", "circle", bundle=bundle.folder, adapt="on")
    assert prepare_flight(setup).request.adaptation.network.mode == "shadow"
