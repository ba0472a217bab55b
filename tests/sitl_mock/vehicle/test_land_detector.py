import numpy as np

from sitl_mock.vehicle.land_detector import LandDetector
from sitl_mock.vehicle.vehicle_interface import MotionState

HOVER = 0.5


def motion(climb: float = 0.0, turning: float = 0.0, sliding: float = 0.0) -> MotionState:
    return MotionState(
        0.0, np.zeros(3), np.array([sliding, 0, climb]), np.array([1.0, 0, 0, 0]), np.array([turning, 0, 0])
    )


def run(detector: LandDetector, start: float, duration: float, *, thrust: float, state: MotionState) -> float:
    """Feed it every 20 ms. Returns when it first reported landed, s after the start, or infinity."""
    landed_at = np.inf
    for k in range(round(duration / 0.02)):
        detector.update(start + 0.02 * k, state, armed=True, thrust=thrust, hover_thrust=HOVER)
        if detector.landed and landed_at == np.inf:
            landed_at = 0.02 * k
    return landed_at


def flying() -> LandDetector:
    detector = LandDetector()
    detector.update(0.0, motion(climb=1.0), armed=True, thrust=0.6, hover_thrust=HOVER)
    assert not detector.landed
    return detector


def test_disarmed_means_landed() -> None:
    detector = flying()
    detector.update(1.0, motion(climb=-3.0), armed=False, thrust=0.0, hover_thrust=HOVER)
    assert detector.landed


def test_landed_follows_ground_contact_and_maybe_landed_within_a_second() -> None:
    assert 0.85 <= run(flying(), 1.0, 2.0, thrust=0.0, state=motion()) <= 1.0


def test_hovering_is_not_landing() -> None:
    assert run(flying(), 1.0, 5.0, thrust=HOVER, state=motion()) == np.inf


def test_falling_turning_and_sliding_are_not_landing() -> None:
    for state in (motion(climb=-2.0), motion(turning=1.0), motion(sliding=3.0)):
        assert run(flying(), 1.0, 5.0, thrust=0.0, state=state) == np.inf


def test_idling_on_the_ground_stays_landed_and_take_off_ends_it_at_once() -> None:
    detector = LandDetector()
    assert run(detector, 0.0, 5.0, thrust=0.2, state=motion()) == 0.0
    assert detector.landed
    detector.update(5.0, motion(), armed=True, thrust=0.55, hover_thrust=HOVER)
    assert not detector.landed
