"""Gauss-Newton with instruments: where its steps end, and where damped steps lead first if its way is not straight."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from diagnosis.thresholds import EquationErrorThresholds
from dynamics.arrays import Floats


@dataclass(frozen=True, eq=False)
class Step:
    """A Gauss-Newton step.

    change: (k,) of the parameters. covariance, information: (k, k) of them. cost: of the fit before the step.
    """

    change: Floats
    covariance: Floats
    information: Floats
    cost: float

    @property
    def deviations(self) -> float:
        """Length of the change, over the standard deviations."""
        return float(np.linalg.norm(self.change / np.sqrt(np.maximum(np.diag(self.covariance), 1e-300))))

    def damped(self, damping: float) -> Floats:
        """(k,) the change with such a share of its own information added to that of each parameter."""
        added = self.information + damping * np.diag(np.abs(np.diag(self.information)))
        return np.asarray(np.linalg.lstsq(added, self.information @ self.change, rcond=None)[0])

    def is_small(self, change: Floats, share: float) -> NDArray[np.bool_]:
        """(k,) whether a change is within a share of the standard deviations."""
        return np.asarray(np.abs(change) <= share * np.sqrt(np.maximum(np.diag(self.covariance), 0.0)) + 1e-15)


class Problem(Protocol):
    """A least-squares problem with instruments."""

    @property
    def thresholds(self) -> EquationErrorThresholds:
        """Of its steps."""
        ...

    def step(self, values: Floats) -> Step:
        """The step from some values (k,)."""
        ...

    def bounded(self, values: Floats, step: Floats) -> Floats:
        """(k,) values after a step, within their bounds."""
        ...

    def at_bounds(self, values: Floats) -> NDArray[np.bool_]:
        """(k,) whether a value is at a physical bound at which its effect does not vanish."""
        ...


def settle_from_afar(problem: Problem, start: Floats, *, hopeless: float = np.inf, goal: float = np.inf) -> Settled:
    """Gauss-Newton (`settle`), begun again from damped steps where its way is not straight; the better of both.

    Columns about a vehicle that lacks much may begin the fit far off, from where Gauss-Newton's steps end at a bound or
    run out: an inertia divides the moments, and one step makes it a fifth or five times as large. hopeless: cost above
    which it is left at that. goal: cost that it must reach to count; within its bounds it is left where it stops short.
    """
    first = settle(problem, start, goal)
    at_bounds = problem.at_bounds(first.values).any()
    is_done = (first.is_straight or first.is_short) and not at_bounds
    if is_done or first.last.cost > hopeless:
        return first
    again = settle(problem, _damped(problem, start), goal)
    return again if again.last.cost < first.last.cost else first


def _damped(problem: Problem, start: Floats) -> Floats:
    """Values to which steps lead that are damped until the fit gets better by each (Levenberg and Marquardt).

    They end where it no longer does by much: near the minimum instruments lead elsewhere.
    """
    thresholds, values, here = problem.thresholds, start, problem.step(start)
    damping = thresholds.damping
    for _ in range(thresholds.max_damped):
        if not np.isfinite(here.cost):
            break
        moved = problem.bounded(values, here.damped(damping))
        there = problem.step(moved)
        if not there.cost < here.cost:
            damping *= thresholds.damping_factor
            continue
        damping /= thresholds.damping_factor
        is_flat = there.cost > (1 - thresholds.min_damped_fall) * here.cost
        values, here = moved, there
        if is_flat:
            break
    return values


@dataclass(frozen=True, eq=False)
class Settled:
    """Where Gauss-Newton has ended.

    values: (k,). last: the step from there. left: (k,) what of it the bounds allow. is_straight: whether every step was
    taken as it was, and the last one is small. is_short: whether its steps no longer led to the goal.
    """

    values: Floats
    last: Step
    left: Floats
    is_straight: bool
    is_short: bool = False


def settle(problem: Problem, start: Floats, goal: float = np.inf) -> Settled:
    """Values to which Gauss-Newton converges.

    A step after which the fit is worse and the next step no smaller is halved: along a hidden state's parameters the
    fit is no parabola. The fit alone cannot judge, since instruments do not lead to its minimum. goal: cost that it
    must reach to count; it ends where two steps in a row take too little off what is above that.
    """
    thresholds, values, is_straight, stalled = problem.thresholds, start, True, 0
    here = problem.step(values)
    change = here.change
    for _ in range(thresholds.max_steps):
        moved = problem.bounded(values, change)
        if np.all(here.is_small(moved - values, thresholds.converged)):
            break
        there = problem.step(moved)
        grown = not there.cost <= thresholds.max_cost_growth * here.cost
        if grown and not (np.isfinite(there.cost) and there.deviations < here.deviations):
            change, is_straight = change / 2, False
            continue
        stalled = stalled + 1 if here.cost - there.cost < thresholds.min_progress * (there.cost - goal) else 0
        values, here, change = moved, there, there.change
        if stalled == thresholds.max_stalled:
            break
    else:
        is_straight = False
    is_short = stalled == thresholds.max_stalled
    left = problem.bounded(values, here.change) - values
    return Settled(values, here, left, is_straight and not is_short, is_short)
