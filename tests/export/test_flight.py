"""An exported model flies: through its kernel, back to physics where it does not know, and bit for bit again."""

from pathlib import Path

import msgspec
import numpy as np
import pytest

from dynamics.errors import RequestError
from dynamics.references import named_reference
from dynamics.vehicle import EffectUse, Limits, Vehicle
from export.bundle import ExportOptions, export_bundle
from export.trained import exported
from runtime.control.adaptation_settings import AdaptationSettings, Mode
from runtime.control.bundle import Bundle, bundle_of, read_bundle
from runtime.control.controller import Controller, ControllerOptions
from runtime.control.rti.problem import Problem
from runtime.control.rti.processor import native_processor
from runtime.flight.engagement import State
from runtime.flight.events import Event
from runtime.flight.phases import Phase
from runtime.flight_setup import FlightSetup, prepare_flight
from simulation.lockstep import FlownReference, fly_reference
from tests.support.rate_controlled_vehicle import PERIOD, Flight, Story
from tests.support.trained import replaced, untrained_model
from training.models import KINDS


@pytest.fixture(scope="module")
def bundle(tmp_path_factory: pytest.TempPathFactory, arpl_250g: Vehicle) -> Bundle:
    """A residual on the nominal model whose output is nearly zero, so that it flies without training."""
    vehicle = msgspec.structs.replace(arpl_250g, limits=Limits(rate=(12.0, 12.0, 6.0)))
    config = replaced(KINDS["res_tcn"].config, channels=8, hidden=(16,))
    model = exported(untrained_model(config, vehicle, gain=0.002))
    folder = tmp_path_factory.mktemp("bundle") / "b"
    return read_bundle(export_bundle(model, folder, ExportOptions(Problem(), native_processor(), windows=20)).folder)


def flight_of(bundle: Bundle) -> Flight:
    controller, nominal = Controller.from_bundle(bundle), Controller.fallback_from_bundle(bundle)
    reference = named_reference("circle:laps=2,speed=0.8", controller.trim)
    return Flight(controller.trim, controller, reference, nominal=nominal)


def test_it_takes_off_on_physics_until_its_history_is_filled_and_tracks_on_its_own(bundle: Bundle) -> None:
    flight = flight_of(bundle)
    story = flight.run(40.0)
    waited = [change for change in story.event_changes if change.event is Event.MODEL_WAITING]
    assert [change.active for change in waited[:2]] == [True, False]
    assert 0.15 < waited[1].time - waited[0].time < 0.4  # 18 columns of 10 ms
    assert story.phases[-1] is Phase.SHUTDOWN
    assert max(story.errors) < 0.3
    assert Event.MODEL_UNHEALTHY not in story.raised


def test_outside_of_its_training_physics_flies_and_it_comes_back_without_a_step(bundle: Bundle) -> None:
    flight = flight_of(bundle)
    flight.run(30.0, until=Phase.TRACK)
    flight.run(0.5)
    flight.findings = {Event.MODEL_OUTSIDE.value: "rate_x is 12"}
    flight.run(0.5)
    assert flight.flyer.engagement.state is State.FALLBACK
    flight.findings = {}
    flight.run(1.0)
    assert flight.flyer.engagement.state is State.ENGAGED
    sent = np.array([decision.rate_body for decision in flight.story.decisions[-210:]])
    thrust = np.array([decision.collective_thrust for decision in flight.story.decisions[-210:]])
    assert np.abs(np.diff(sent, axis=0)).max() < 0.2  # rad/s from one tick to the next
    assert np.abs(np.diff(thrust)).max() < 0.05 * bundle.vehicle.weight


@pytest.fixture(scope="module")
def grey_box(tmp_path_factory: pytest.TempPathFactory, arpl_250g: Vehicle) -> Bundle:
    """A residual on a model with effects, whose output is nearly zero."""
    vehicle = arpl_250g.with_effects(EffectUse("rotor_drag", {"coefficient": 2.2e-5}))
    config = replaced(KINDS["grey_box"].config, channels=8, hidden=(16,))
    model = exported(untrained_model(config, vehicle, gain=0.002))
    folder = tmp_path_factory.mktemp("grey_box") / "b"
    return read_bundle(export_bundle(model, folder, ExportOptions(Problem(), native_processor(), windows=20)).folder)


def in_wind(bundle: Bundle, mode: Mode) -> tuple[FlownReference, Controller, Controller]:
    """A hover in 6 m/s of wind, of which neither the network nor the vehicle file's model knows."""
    options = ControllerOptions.for_vehicle(bundle.vehicle, adaptation=AdaptationSettings(mode=mode))
    controller, nominal = Controller.from_bundle(bundle, options), Controller.fallback_from_bundle(bundle, options)
    assert nominal is not None
    hidden = [EffectUse("rotor_drag", {"coefficient": 2.2e-5}), EffectUse("wind", {"x": 6.0, "y": 0.0, "z": 0.0})]
    if bundle.vehicle.effects:
        del hidden[0]
    reference = named_reference("Hover", bundle.vehicle, duration=8.0)
    flight = fly_reference(bundle.vehicle, reference, effects=hidden, seed=5, controller=controller, nominal=nominal)
    return flight, controller, nominal


@pytest.mark.long("compiles a network, and flies it twice")
@pytest.mark.parametrize("kind", [pytest.param("bundle", marks=pytest.mark.slow), "grey_box"])
def test_a_learned_model_follows_the_wind_and_so_does_the_fallback_beside_it(
    request: pytest.FixtureRequest, kind: str
) -> None:
    bundle = request.getfixturevalue(kind)
    assert in_wind(bundle, "off")[0].position_rmse > 0.12
    flight, controller, nominal = in_wind(bundle, "on")
    assert flight.fallbacks == 0
    assert flight.position_rmse < 0.015
    assert controller.adaptation is not None
    assert nominal.adaptation is not None
    own, fallback = (np.array(a.followed.disturbance[:3]) for a in (controller.adaptation, nominal.adaptation))
    assert own[0] > 2.0  # m/s^2 downwind
    np.testing.assert_allclose(fallback, own, atol=0.3)  # the network itself pushes by as much


def limited(bundle: Bundle, limits: Limits) -> Bundle:
    """The bundle of a vehicle with other limits, which its kernel is told when it starts."""
    vehicle = msgspec.structs.replace(bundle.vehicle, limits=limits)
    return bundle_of(bundle.folder, bundle.manifest, vehicle, bundle.vehicle_text)


NARROW = Limits(rate=(0.4, 0.4, 6.0), speed=1.5)  # free, it flies up to 1.9 m/s and 0.45 rad/s


@pytest.fixture(scope="module")
def narrow(bundle: Bundle) -> Story:
    """A flight whose reference leaves the vehicle's limits."""
    return flight_of(limited(bundle, NARROW)).run(30.0, until=Phase.RETURN)


def test_the_network_itself_keeps_a_speed_and_body_rates_that_the_reference_leaves(narrow: Story) -> None:
    story, limits = narrow, NARROW
    assert story.phases[-1] is Phase.RETURN
    assert np.abs(np.array(story.states)[:, 3:6]).max() < 1.05 * limits.speed  # soft: a row is paid for, not forbidden
    commanded = np.array([decision.rate_body for decision in story.decisions if decision.rate_body is not None])
    assert np.abs(commanded[:, :2]).max() <= 1.05 * limits.rate[0]


def test_no_solution_fails_at_the_limits(narrow: Story) -> None:
    assert Event.SOLVER_FAILED not in narrow.raised


def test_the_network_itself_brakes_at_the_box_that_the_reference_leaves_and_lands_there(bundle: Bundle) -> None:
    edge = 1.0  # m; the circle reaches 1.5 m
    limits = Limits(rate=(12.0, 12.0, 6.0), box=((-5.0, -5.0, -1.0), (edge, 5.0, 5.0)))
    story = flight_of(limited(bundle, limits)).run(40.0)
    assert story.phases[-1] is Phase.SHUTDOWN
    assert edge - 0.02 < np.array(story.states)[:, 0].max() < edge + 0.02
    assert Event.GEOFENCE_LEFT not in story.raised
    assert Event.SOLVER_FAILED not in story.raised


def test_estimates_that_are_missing_leave_its_history_on_the_grid_and_the_flight_reproducible(bundle: Bundle) -> None:
    flight = flight_of(bundle)
    flight.run(30.0, until=Phase.TRACK)
    flight.run(0.5)
    for _ in range(12):
        flight.frozen = True
        flight.run(0.03)
        flight.frozen = False
        flight.run(0.12)
    controller = flight.flyer.controllers.main
    taken = controller._acting + controller.options.period - 0.01 * np.arange(len(controller.solver.history), 0, -1)
    flown = taken <= flight.story.times[-1] - 0.02  # later columns are predictions
    truth = np.array(
        [np.interp(taken[flown], flight.story.times, np.array(flight.story.states)[:, axis]) for axis in range(6)]
    ).T
    assert flown.sum() > 10
    np.testing.assert_allclose(controller.solver.history[flown, :3], truth[:, :3], atol=0.005)  # 20 mm are a column
    np.testing.assert_allclose(controller.solver.history[flown, 3:6], truth[:, 3:6], atol=0.05)
    assert Event.MODEL_WAITING not in {change.event for change in flight.story.event_changes if change.time > 110.0}
    again = flight_of(bundle).flyer
    for (observation, estimate), before in zip(flight.story.observations, flight.story.decisions, strict=True):
        decision = again.step(observation, estimate)
        again.prepare(observation.time)
        np.testing.assert_array_equal(decision.rate_body, before.rate_body)
        assert (decision.thrust, decision.fallback) == (before.thrust, before.fallback)


def test_a_state_outside_of_the_training_range_is_noticed(bundle: Bundle) -> None:
    controller = Controller.from_bundle(bundle)
    state = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, *[0.0] * 6])
    controller.reset(state, 0.0)
    controller.compensate(state, 0.01, 0.01)
    assert controller.model_faults(0.01)[1] == ""
    state[10] = 30.0
    controller.compensate(state, 0.02, 0.02)
    assert "rate_x is 30, trained on" in controller.model_faults(0.02)[1]


def test_a_vehicle_that_does_otherwise_than_predicted_is_noticed(bundle: Bundle) -> None:
    controller = Controller.from_bundle(bundle)
    state = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, *[0.0] * 6])
    controller.reset(state, 0.0)
    for tick in range(100):
        now = tick * PERIOD
        controller.compensate(state, now, now + 0.02)
        state = state.copy()
        state[3] += 0.2 * PERIOD  # a breeze, less than estimates resolve
    assert controller.model_faults(1.0)[2] == ""
    for tick in range(100, 200):
        now = tick * PERIOD
        controller.compensate(state, now, now + 0.02)
        state = state.copy()
        state[3] += 8.0 * PERIOD
    assert "times the training error" in controller.model_faults(2.0)[2]


def test_delay_is_made_up_for_by_the_model_itself(bundle: Bundle) -> None:
    """A truth that the kernel itself flies is recovered from estimates 30 ms old."""
    options = msgspec.structs.replace(Controller.from_bundle(bundle).options, delay=0.0)
    controller, truth_of = Controller.from_bundle(bundle, options), Controller.from_bundle(bundle, options)
    state = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, *[0.0] * 6])
    controller.reset(state, 0.0)
    truth_of.reset(state, 0.0)
    rng, past = np.random.default_rng(0), [state]
    columns = [np.concatenate([state, [bundle.vehicle.hover_speed] * 4])] * 30
    for tick in range(60):
        now = tick * PERIOD
        compensated = controller.compensate(past[-1 - min(3, tick)], now - PERIOD * min(3, tick), now)
        np.testing.assert_allclose(compensated, past[-1], atol=1e-6)
        speed = bundle.vehicle.hover_speed * (1 + 0.05 * rng.normal(size=4))
        controller.solver.inputs[0] = speed
        controller._take_state(compensated, now)
        controller._remember(controller._acting, speed)
        columns.append(np.concatenate([past[-1], speed]))
        truth_of.solver.history[:] = columns[-1 - len(truth_of.solver.history) : -1]
        past.append(truth_of.solver.propagate(past[-1], speed, PERIOD).copy())


def test_a_learned_bundle_is_checked_before_anything_is_sent(bundle: Bundle, tmp_path: Path) -> None:
    setup = FlightSetup(link="udpin:127.0.0.1:14999", reference="circle", bundle=bundle.folder)
    assert prepare_flight(setup).bundle is not None
    (tmp_path / "model.onnx").write_bytes(b"")
    (tmp_path / "vehicle.toml").write_text(bundle.vehicle_text)
    with pytest.raises(RequestError, match="is no bundle"):
        prepare_flight(msgspec.structs.replace(setup, bundle=tmp_path))
