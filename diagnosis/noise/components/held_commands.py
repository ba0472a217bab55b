"""Held commands: the log keeps one command a row and the model holds it; those between are noise of the rotor speed."""

from collections.abc import Callable, Mapping
from functools import partial

import numpy as np

from diagnosis.noise.component import Component, FlightConditions, Hyperparameter, Values, fixed_prior
from diagnosis.noise.linear_model import LinearModel, compose, white
from dynamics.arrays import Floats

Share = Callable[[float], float]


def held(m: float) -> float:
    """(m - 1) (2 m - 1) / (6 m^2): mean of m commands about the first, each the former and a step of variance 1 / m."""
    return (m - 1) * (2 * m - 1) / (6 * m**2)


def density(p: Values, c: FlightConditions, share: Share) -> float:
    """Two-sided density: the variance walk^2 period share(m) of each row's mean, times period."""
    return p["walk"] ** 2 * c.period**2 * share(max(1.0, c.command_rate * c.period))


def model(p: Values, c: FlightConditions, share: Share = held) -> LinearModel:
    """White noise of each rotor's speed; its mean over a row of m commands has the variance walk^2 period share(m)."""
    rotors = range(c.vehicle.rotors.count)
    return compose([white(f"rotor_speed_{rotor}", np.sqrt(density(p, c, share))) for rotor in rotors])


def spectrum(p: Values, c: FlightConditions, frequency: Floats, share: Share = held) -> Mapping[str, Floats]:
    """walk^2 period^2 share(m)."""
    return {output: np.full(len(frequency), density(p, c, share)) for output in model(p, c, share).outputs}


def component(name: str, summary: str, source: str, share: Share) -> Component:
    """Noise of the commands between rows. share: variance of a row's mean over walk^2 period, by commands a row."""
    walk = Hyperparameter("walk", "rad/s^1.5", "random walk of commands in a row", 1e-3, 1e5, fixed_prior(50.0, 1.5))
    return Component(name, summary, source, (walk,), partial(model, share=share), partial(spectrum, share=share))


COMPONENT = component(
    "held_commands",
    "Commands that the log left out, of rows whose command is held",
    "mean of a sampled random walk about its first value: the sum of squares of the steps' weights",
    held,
)
