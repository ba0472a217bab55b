"""A gust: air that moves at random and pushes through drag, told by the slow force that the noise's fit finds.

Force that lasts for seconds is always there: the room's own air, the rotors' turbulence. It is about as large as the
same turbulence's fast force. Three more things push sideways for seconds: a gust of intensity w through drag; to a
model with drag, a velocity that an estimator lets drift; and what functions that are left do not quite fit. With a fast
level f, r f slow, a slope k of specific force in the air's velocity, and e of the last two,

    slow^2 = (r f)^2 + e^2 + (w k)^2

where the noise's fit has both levels and their deviations. That of the fast one is of its variance: of a small level
beneath a large one the readings tell how large it is at most, and not how small. The odds of a gust are those of all w
against none, all else integrated out with its prior.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from diagnosis.likelihood import priors
from diagnosis.likelihood.left_over import Left, LeftOver
from diagnosis.likelihood.noise_fit import NoiseFit
from diagnosis.likelihood.problem import FEW, Problem
from diagnosis.likelihood.rigid_body import OUTPUTS, FlightModel
from diagnosis.noise.component import LogNormal
from diagnosis.selection.candidates import Candidate
from dynamics.arrays import Floats
from dynamics.effect import Effect
from dynamics.vehicle import EffectUse

SLOW, FAST = "slow_turbulence.force_xy", "turbulence.force_xy"
FINE = 61  # values of each that are integrated over


@dataclass(frozen=True)
class Gust:
    """A gust as far as flights show it.

    log_odds: against none. intensity, std: m/s. effect: the catalogue's.
    """

    effect: Effect
    log_odds: float
    intensity: float
    std: float

    @property
    def probability(self) -> float:
        """Of it, where a gust and none were alike before."""
        return float(scipy.special.expit(self.log_odds))


@dataclass(frozen=True)
class SlowForce:
    """The slow force sideways in some flights, over the mass.

    level, fast: m/s^2, of it and of the same turbulence's fast one. std, fast_std: of their logarithms, as fitted.
    slope: of specific force in the air's velocity, 1/s. other: m/s^2, what else pushes so; None where nothing does.
    """

    level: float
    std: float
    fast: float
    fast_std: float
    slope: float
    other: LogNormal | None = None


def gust_in(problems: Sequence[Problem], left: LeftOver) -> Gust | None:
    """The gust in flights of each kind of logs, however unlikely; None where the catalogue has no gust or no wind, or
    no air is felt. left: beside the effects."""
    effect = next((e for e in problems[0].catalogue.values() if e.stochastic and e.wind is not None), None)
    steady = next((c for c in problems[0].what.all if c.effect.wind is not None), None)
    if effect is None or steady is None:
        return None
    forces = [
        _slow_force(problem, noise, steady, left.left)
        for problem, noise in zip(problems, left.noise, strict=True)
        if "velocity" in problem.flights[0].readings
    ]
    felt = [force for force in forces if force.slope > 0]
    return gust_of(effect, felt) if felt else None


def gust_of(effect: Effect, forces: Sequence[SlowForce]) -> Gust:
    """One gust in all of some flights."""
    values, weight = _nodes(priors.GUST, 4 * FINE)
    density = np.sum([_log_density(force, values) for force in forces], axis=0)
    still = sum(float(_log_density(force, np.zeros(1))[0]) for force in forces)
    posterior = weight * np.exp(density - density.max())
    log_odds = float(density.max() + np.log(posterior.sum()) - still)
    posterior /= posterior.sum()
    mean = float(posterior @ values)
    return Gust(effect, log_odds, mean, float(np.sqrt(posterior @ (values - mean) ** 2)))


def _log_density(force: SlowForce, intensity: Floats) -> Floats:
    """(w,) log of the density of a slow force's level in gusts of (w,) intensities, m/s."""
    (ratio, of_ratio), (other, of_other) = _nodes(priors.SLOW, FINE), _nodes(force.other, FINE // 3)
    fast = np.linspace(0, 1 + 6 * 2 * force.fast_std, FINE)[1:]  # variance over the fit's
    of_fast = np.exp(-(((fast - 1) / (2 * force.fast_std)) ** 2) / 2)
    still = (force.fast * ratio[:, None]) ** 2 * fast
    squares = still[:, :, None] + other**2 + (intensity[:, None, None, None] * force.slope) ** 2
    density = np.exp(-((np.log(squares / force.level**2) / (2 * force.std)) ** 2) / 2) @ of_other
    total = density @ (of_fast / of_fast.sum()) @ of_ratio
    return np.asarray(np.log(np.maximum(total, np.finfo(float).tiny)))


def _nodes(prior: LogNormal | None, count: int) -> tuple[Floats, Floats]:
    """Values and their prior's weights; nothing without one."""
    if prior is None:
        return np.zeros(1), np.ones(1)
    off = np.linspace(-6, 6, count)
    weight = np.exp(-(off**2) / 2)
    return prior.median * np.exp(off * prior.spread), weight / weight.sum()


def _slow_force(problem: Problem, noise: NoiseFit, steady: Candidate, left: Sequence[Left]) -> SlowForce:
    """The slow force that a fit of the noise has found. steady: wind, by whose slopes the air is felt."""
    mass, name = problem.vehicle.body.mass, steady.effect.name
    uses = {use.name: use for use in problem.uses}
    uses.setdefault(name, EffectUse(name, dict(steady.at)))
    model, slopes = FlightModel(problem.vehicle, list(uses.values()), problem.catalogue), []
    for place in range(min(FEW, len(problem.flights))):
        rows, along = problem.flights[place], problem.along(place)
        path = model.hidden_path(rows, model.driving(rows, along.reference), problem.starts.get(place, {}))
        by_air = model.parameter_slopes(rows, along, [f"{name}.{each}" for each in steady.free], path)
        slopes.append(by_air[:, :, OUTPUTS["force"]][:, :, :2])
    slope = float(np.sqrt(np.mean(np.sum(np.concatenate(slopes) ** 2, axis=(1, 2))) / len(steady.free)))
    return SlowForce(
        level=noise.values[SLOW] / mass,
        std=noise.deviations[SLOW],
        fast=noise.values[FAST] / mass,
        fast_std=noise.deviations[FAST],
        slope=slope,
        other=_other(slope if problem.flights[0].segment.pose_source == "estimator" else 0.0, left),
    )


def _other(drag: float, left: Sequence[Left]) -> LogNormal | None:
    """Other things that push sideways for seconds. drag: that feels an estimator's velocity, 1/s."""
    functions = [one for one in left if one.channel < 2 and one.discrepancy.of.kind != "line"]
    of_functions = priors.UNFITTED.median * float(np.sqrt(sum(one.rms**2 for one in functions)))
    size = float(np.hypot(priors.DRIFT.median * drag, of_functions))
    return LogNormal(size, priors.UNFITTED.spread if functions else priors.DRIFT.spread) if size > 0 else None
