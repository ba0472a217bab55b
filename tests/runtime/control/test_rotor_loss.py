"""A rotor that loses thrust in flight is named, and nothing else is mistaken for one."""

import numpy as np
import pytest

from dynamics.references import named_reference
from dynamics.vehicle import EffectUse, Vehicle
from runtime.control.adaptation_settings import AdaptationSettings
from runtime.control.controller import Controller, ControllerOptions
from runtime.control.rotor_loss import RotorLoss, RotorLossTest
from simulation.lockstep import FlownReference, ParameterStep, fly_reference

# of arpl_250g in hover: each rotor's acceleration along body z, and about body x and y
HOVER = np.array([[2.45, 78.0, -79.0], [2.45, 78.0, 79.0], [2.45, -78.0, 79.0], [2.45, -78.0, -79.0]])
NOISE = np.array([0.07, 0.2, 0.2])


def judged(step: np.ndarray, seed: int = 0, shares: np.ndarray = HOVER, at: int = 40) -> list[tuple[int, RotorLoss]]:
    """What blocks of noise name, with a step after so many of them: the losses and their blocks."""
    test, random, named = RotorLossTest(4), np.random.default_rng(seed), []
    for block in range(100):
        loss = test.add(NOISE * random.normal(size=3) + step * (block >= at), shares, 0.1)
        if loss is not None:
            named.append((block, loss))
    return named


@pytest.mark.parametrize("rotor", range(4))
@pytest.mark.parametrize("share", [0.1, 0.15, 0.4])
def test_a_rotor_that_loses_thrust_is_named_with_its_loss(rotor: int, share: float) -> None:
    ((block, loss),) = judged(-share * HOVER[rotor], seed=rotor)
    assert loss.rotor == rotor
    assert abs(loss.share - share) < 2 * loss.deviation
    assert block - 40 <= 35


def test_noise_names_nothing() -> None:
    assert all(not judged(np.zeros(3), seed) for seed in range(50))


@pytest.mark.parametrize(
    "step",
    [
        pytest.param(np.array([0.0, -12.0, 12.0]), id="centre of mass under a rotor"),
        pytest.param(np.array([-1.6, 0.0, 0.0]), id="payload under the centre"),
        pytest.param(np.array([1.6, 0.0, 0.0]), id="payload dropped"),
        pytest.param(-0.15 * (HOVER[0] + HOVER[1]), id="two rotors at once"),
        pytest.param(0.15 * HOVER[0], id="a rotor that gains"),
        pytest.param(np.array([-0.4, -12.0, 0.0]), id="moment about one axis"),
        pytest.param(-0.03 * HOVER[0], id="a scratch"),
        pytest.param(np.array([-1.96, 0.24, -0.24]) * [1.0, 78.0, 79.0], id="payload on the way to a rotor"),
        pytest.param(np.array([-1.96, 0.4, -0.3]) * [1.0, 78.0, 79.0], id="payload further out"),
        pytest.param(np.array([-1.96, -0.33, -0.42]) * [1.0, 78.0, 79.0], id="payload beside a rotor"),
    ],
)
def test_what_is_no_rotor_s_is_not_named(step: np.ndarray) -> None:
    assert all(not judged(step, seed) for seed in range(10))


def test_what_was_there_at_take_off_is_not_named() -> None:
    assert not judged(-0.15 * HOVER[2], at=0)


def test_what_was_there_at_take_off_is_not_named_where_thrust_rises() -> None:
    """A bent propeller, or a load, takes more away where the vehicle flies faster: a step, but none of the vehicle."""
    for seed in range(10):
        test, random = RotorLossTest(4), np.random.default_rng(seed)
        for block in range(100):
            thrust = 1.0 if block < 40 else 1.4
            beyond = -0.2 * thrust * HOVER[0] + NOISE * random.normal(size=3)
            assert test.add(beyond, thrust * HOVER, 0.1) is None


def test_a_second_loss_of_the_same_rotor_adds_up() -> None:
    test, random = RotorLossTest(4), np.random.default_rng(1)
    for block in range(160):
        share = 0.1 * (block >= 40) + 0.1 * (block >= 100)
        test.add(NOISE * random.normal(size=3) - share * HOVER[1], HOVER, 0.1)
    assert list(test.losses) == [1]
    assert test.losses[1].share == pytest.approx(0.2, abs=0.03)


def test_values_that_are_none_move_nothing() -> None:
    test = RotorLossTest(4)
    for block in range(100):
        broken = block % 7 == 0
        assert test.add(np.full(3, np.nan if broken else 0.0), HOVER, 0.1) is None


def flown(
    vehicle: Vehicle, name: str, effect: str, step: dict[str, float], rotor: int | None = None, mode: str = "on"
) -> FlownReference:
    """A flight with an effect at its neutral value that changes after 6 s."""
    settings = AdaptationSettings(mode=mode)  # type: ignore[arg-type]
    controller = Controller.build(vehicle, ControllerOptions.for_vehicle(vehicle, adaptation=settings))
    neutral = {"weak_rotor": {"loss": 0.0, "torque_loss": 0.0}, "centre_of_mass": {"x": 0.0, "y": 0.0, "z": 0.0}}
    use = EffectUse(effect, neutral.get(effect, {"ratio": 1.0}), rotor)
    values = {f"{use.label}.{key}": value for key, value in step.items()}
    reference = named_reference(name, vehicle, duration=12.0)
    steps = [ParameterStep(6.0, values)]
    flight = fly_reference(vehicle, reference, effects=[use], seed=7, controller=controller, steps=steps)
    assert controller.adaptation is not None
    assert controller.adaptation.rotors is not None
    named = [loss.rotor for loss in controller.adaptation.rotors.losses]
    assert named == ([] if rotor is None else [rotor])
    return flight


@pytest.mark.parametrize(("name", "rotor"), [("Hover", 2), ("Lemniscate", 1)])
def test_it_is_named_in_flight(arpl_250g: Vehicle, name: str, rotor: int) -> None:
    flight = flown(arpl_250g, name, "weak_rotor", {"loss": 0.15}, rotor)
    assert flight.events["rotor_weak"] == 1
    assert not flight.aborted


def test_a_loss_beyond_the_limit_ends_the_flight(arpl_250g: Vehicle) -> None:
    flight = flown(arpl_250g, "Hover", "weak_rotor", {"loss": 0.3}, 0)
    assert "rotor 0 has lost 30 +-" in flight.aborted
    assert flight.seconds < 11.0
    assert not flown(arpl_250g, "Hover", "weak_rotor", {"loss": 0.3}, 0, mode="shadow").aborted


@pytest.mark.parametrize(
    ("effect", "step"),
    [("centre_of_mass", {"x": 0.004, "y": -0.004}), ("mass", {"ratio": 1.2}), ("mass", {"ratio": 0.8})],
)
def test_a_load_that_shifts_falls_or_is_taken_up_is_no_rotor(
    arpl_250g: Vehicle, effect: str, step: dict[str, float]
) -> None:
    assert "rotor_weak" not in flown(arpl_250g, "Hover", effect, step).events
