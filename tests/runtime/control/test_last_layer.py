"""The last layer's change is the textbook's regression, finds what was planted, and is bounded, forgotten, refused."""

from collections.abc import Iterator

import msgspec
import numpy as np
import pytest

from dynamics import quaternion
from dynamics.arrays import Floats
from runtime.control.adaptation_settings import AdaptationSettings, NetworkSettings
from runtime.control.last_layer import LastLayer
from runtime.control.network_features import NetworkFeatures, whitened

RANK = 4
DT = 0.01


def layer_of(**settings: float) -> LastLayer:
    """A layer on features that are their own inputs."""
    features = NetworkFeatures(np.eye(RANK, RANK + 1), body=True)
    return LastLayer(features, AdaptationSettings(network=NetworkSettings(mode="on", **settings)))  # type: ignore[arg-type]


def rows(seconds: float, seed: int = 0) -> Iterator[tuple[Floats, Floats]]:
    """Features (k,) that vary over seconds, and rotations (3, 3), every 10 ms."""
    random = np.random.default_rng(seed)
    phases, rates = random.uniform(0, 6, RANK), random.uniform(0.5, 4, RANK)
    for time in np.arange(0, seconds, DT):
        attitude = quaternion.exponential(np.array([0.4 * np.sin(time), 0.3 * np.cos(0.7 * time), 0.2 * time]))
        yield np.sqrt(2) * np.sin(rates * time + phases), np.asarray(quaternion.rotation_matrix(attitude))


def taught(layer: LastLayer, change: Floats, force: Floats, seconds: float = 20.0, noise: float = 0.02) -> None:
    """Seconds of flight in which a change (3, k) and a constant force (3,) act, m/s^2."""
    random = np.random.default_rng(1)
    error = np.zeros(3)
    for psi, rotation in rows(seconds):
        new = noise * random.normal(size=3)  # of the estimate's velocity, m/s
        layer.add(DT * (rotation @ change @ psi + force) + new - error, psi, rotation, DT, 0.3)
        error = new


def test_the_update_is_the_textbook_s_regression() -> None:
    """Without any memory to lose, and no force beside it, the change is that of all rows at once with the prior."""
    quiet = msgspec.structs.replace(AdaptationSettings().linear, drift=1e-9, fading=1e-9)
    settings = AdaptationSettings(
        linear=quiet, gate=1e6, network=NetworkSettings(mode="on", memory=1e12, bound=1e6, deviation=0.7)
    )
    layer = LastLayer(NetworkFeatures(np.eye(RANK, RANK + 1), body=True), settings)
    random, designs, values = np.random.default_rng(2), [], []
    for place, (psi, rotation) in enumerate(rows(6.0)):
        if place % 10 == 0:
            mean, design = random.normal(size=3), np.zeros((3, 3, RANK))
        layer.add(DT * mean, psi, rotation, DT, 1.0)
        design += rotation[:, :, None] * psi / 10
        if place % 10 == 9:
            designs.append(design.reshape(3, -1))
            values.append(mean)
    D, y = np.concatenate(designs), np.concatenate(values)
    noise, prior = layer._noise(0.1), 0.7**2 / RANK
    information = D.T @ D / noise + np.eye(3 * RANK) / prior
    np.testing.assert_allclose(layer.change.ravel(), np.linalg.solve(information, D.T @ y / noise), rtol=1e-4)


def test_a_planted_change_is_found_beside_a_force() -> None:
    layer, change = layer_of(), np.random.default_rng(3).normal(size=(3, RANK)) * 0.4
    taught(layer, change, np.array([1.0, -0.5, 0.2]))
    np.testing.assert_allclose(layer.change, change, atol=0.12)
    assert layer.trust == 1
    assert layer.squares[0] < 0.7 * layer.squares[1]
    assert layer.deviation < 0.8 * layer.settings.network.deviation


def test_a_constant_force_is_the_disturbance_s() -> None:
    layer = layer_of()
    taught(layer, np.zeros((3, RANK)), np.array([2.0, -1.0, 0.5]))
    assert np.linalg.norm(layer.change, axis=1).max() < 0.15


def test_the_change_stays_within_its_bounds() -> None:
    layer = layer_of(bound=0.5, limit=0.6)
    taught(layer, np.full((3, RANK), 3.0), np.zeros(3))
    assert np.linalg.norm(layer.change, axis=1).max() <= 0.5 + 1e-12
    far = np.full(RANK, 5.0)  # far from what the network was trained on
    assert np.linalg.norm(layer.within(far) * layer.change @ far) == pytest.approx(0.6)
    assert layer.within(0.01 * far) == 1


def test_what_is_not_seen_again_is_forgotten() -> None:
    layer = layer_of(memory=3.0)
    taught(layer, np.full((3, RANK), 0.5), np.zeros(3))
    before = np.linalg.norm(layer.change)
    for _ in range(1000):
        layer.add(np.zeros(3), np.zeros(RANK), np.eye(3), DT, 0.3)
    assert np.linalg.norm(layer.change) < 0.05 * before
    assert layer.deviation == pytest.approx(layer.settings.network.deviation, rel=0.01)


@pytest.mark.parametrize("jump", [np.nan, np.inf, 1.0])
def test_a_velocity_that_jumps_moves_nothing(jump: float) -> None:
    layer = layer_of()
    taught(layer, np.full((3, RANK), 0.3), np.zeros(3), seconds=5.0)
    before = layer.change.copy()
    layer.add(np.full(3, jump), np.ones(RANK), np.eye(3), 0.1, 0.3)
    np.testing.assert_allclose(layer.change, before, rtol=0.05)
    assert np.isfinite(layer.squares).all()


def test_a_change_that_forecasts_worse_is_not_flown_and_returns() -> None:
    layer = layer_of()
    taught(layer, np.full((3, RANK), 0.5), np.zeros(3))
    trust = []
    for change in (-0.5, 0.5):  # the opposite of what was learned, then as before
        taught(layer, np.full((3, RANK), change), np.zeros(3), seconds=2.0 if change < 0 else 12.0)
        trust.append(layer.trust)
    assert trust[0] < 0.5
    assert trust[1] == 1


def test_the_features_are_white_in_training() -> None:
    random = np.random.default_rng(5)
    inputs = np.maximum(0, random.normal(size=(5000, 6)) @ random.normal(size=(6, 6)) + 0.5)
    phi = np.hstack([inputs, np.ones((5000, 1))])
    features = whitened(phi.T @ phi / 5000, 5, body=True)
    psi = np.array([features.of(row) for row in inputs])
    np.testing.assert_allclose(psi.T @ psi / 5000, np.eye(5), atol=1e-9)
