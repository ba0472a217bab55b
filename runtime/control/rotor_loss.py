"""Which rotor has lost thrust in flight, and how much: a test for a step in what accelerates the body.

A generalised likelihood ratio test (Willsky and Jones 1976) on means over blocks of 0.1 s: acceleration along body z
and angular acceleration about body x and y, beyond the model with the speeds that the rotors really had. A rotor that
loses the share l of its thrust takes l times its own part away; a shifted centre of mass leaves the thrust, a payload
the moments, and a wind moves neither as a rotor does. Steps alone count: what was there at take-off may be a centre of
mass, a mass or a bent propeller. Yaw says nothing of thrust: a broken blade is dragged less, a bent one more.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import msgspec
import numpy as np

from dynamics.arrays import Floats

SHOWN = 3  # acceleration along body z, angular acceleration about body x and y


class RotorLossSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """When a rotor is named.

    block: s over which accelerations are averaged.
    after: blocks after a step that are tried.
    before: blocks before it, at least and at most.
    gap: blocks between both that belong to neither. As many on a side are as their side is, or the step is elsewhere.
    correlation: of a block with the next one, at least: what the model has wrong is no white noise.
    linear_floor: m/s^2 that a block is uncertain by at least.
    angular_floor: the same of angular accelerations, share of the rotor's own.
    model_error: share by which the rotor's own accelerations may be wrong.
    significance: standard deviations of the loss from zero.
    fit: chi-square, with two degrees of freedom, up to which the rotor explains the step.
    rival: by how much the chi-square of anything else is greater.
    smallest: loss that is named.
    persistence: blocks in a row that name the same rotor.
    limit: loss beyond which the vehicle does not take off again.
    """

    block: float = 0.1
    after: tuple[int, ...] = (10, 20, 30, 45)
    before: tuple[int, int] = (15, 60)
    gap: int = 3
    correlation: float = 0.5
    linear_floor: float = 0.05
    angular_floor: float = 0.015
    model_error: float = 0.1
    significance: float = 5.0
    fit: float = 9.0
    rival: float = 9.0
    smallest: float = 0.05
    persistence: int = 3
    limit: float = 0.2


@dataclass(frozen=True)
class RotorLoss:
    """Share of its thrust that a rotor has lost, with its standard deviation. rotor: in the vehicle file's order."""

    rotor: int
    share: float
    deviation: float


class RotorLossTest:
    """Blocks of accelerations, and the losses that they have shown.

    losses: by rotor, in the order in which they were named.
    sums: (1 + n, 3) of the block so far, accelerations beyond the model, then of each rotor's whole thrust, times the
        seconds that each lasted.
    """

    def __init__(self, rotors: int, settings: RotorLossSettings | None = None) -> None:
        self._settings = settings or RotorLossSettings()
        self._capacity = self._settings.before[1] + self._settings.gap + self._settings.after[-1]
        self._beyond = np.zeros((self._capacity, SHOWN))
        self._shares = np.zeros((self._capacity, rotors, SHOWN))
        self._rotors, self._seconds = rotors, 0.0
        self.sums = np.zeros((1 + rotors, SHOWN))
        self.losses: dict[int, RotorLoss] = {}
        self.clear()

    def clear(self) -> None:
        """Forget the blocks, as where accelerations before do not compare with those after; losses stay."""
        self._count = self._in_a_row = 0
        self._named: int | None = None
        self._restart_block()

    def add(self, beyond: Floats, shares: Floats, seconds: float) -> RotorLoss | None:
        """Take accelerations over some seconds. Returns the loss of a rotor that they name.

        beyond: (3,) beyond the model: along body z, m/s^2, about body x and y, rad/s^2. shares: (n, 3) those of each
        rotor's whole thrust.
        """
        self.sums[0] += seconds * beyond
        self.sums[1:] += seconds * shares
        return self.advance(seconds)

    def advance(self, seconds: float) -> RotorLoss | None:
        """Take what was added to `sums` over some seconds. A block that is not finite does not count."""
        self._seconds += seconds
        if self._seconds < self._settings.block - 1e-6:
            return None
        means = self.sums / self._seconds
        self._restart_block()
        if not math.isfinite(float(means.sum())):
            return None
        named = np.zeros(self._rotors)
        for loss in self.losses.values():
            named[loss.rotor] = loss.share
        self._append(means[0] + named @ means[1:], means[1:])
        return self._judge()

    def _append(self, beyond: Floats, shares: Floats) -> None:
        if self._count == self._capacity:
            self._beyond[:-1], self._shares[:-1] = self._beyond[1:], self._shares[1:].copy()
            self._count -= 1
        self._beyond[self._count], self._shares[self._count] = beyond, shares
        self._count += 1

    def _restart_block(self) -> None:
        self.sums[:], self._seconds = 0.0, 0.0

    def _judge(self) -> RotorLoss | None:
        settings = self._settings
        if not self._moved():
            self._in_a_row, self._named = 0, None
            return None
        minimum = settings.before[0] + settings.gap
        candidates = (self._step(blocks) for blocks in settings.after if self._count - blocks >= minimum)
        best = max((c for c in candidates if c is not None), key=lambda c: c.share / c.deviation, default=None)
        rotor = None if best is None else best.rotor
        self._in_a_row = self._in_a_row + 1 if rotor == self._named else 1
        self._named = rotor
        if best is None or self._in_a_row < settings.persistence:
            return None
        before = self.losses.get(best.rotor)
        share = best.share if before is None else before.share + best.share
        self.losses[best.rotor] = loss = RotorLoss(best.rotor, share, best.deviation)
        self.clear()  # the step is over: what comes next is compared with what is now
        return loss

    def _moved(self) -> bool:
        """Whether moments are others than before at all, by half of the smallest loss: the cheap question first."""
        start = self._count - self._settings.after[0]
        if start < 1:
            return False
        beyond = self._beyond[: self._count, 1:]
        step = np.abs(beyond[start:].mean(axis=0) - beyond[:start].mean(axis=0))
        size = np.abs(self._shares[self._count - 1, :, 1:]).max(axis=0)
        return bool((step > 0.5 * self._settings.smallest * size).any())

    def _step(self, blocks: int) -> RotorLoss | None:
        """The rotor that explains a step so many blocks ago, if one does and nothing else."""
        settings, now = self._settings, self._count
        start = now - blocks
        end = start - settings.gap
        oldest = max(0, end - settings.before[1])
        before, after = self._beyond[oldest:end], self._beyond[start:now]
        each = self._shares[start:now]
        shares, step = each.mean(axis=0), after.mean(axis=0) - before.mean(axis=0)
        floor = np.array([settings.linear_floor, *settings.angular_floor * np.abs(shares).mean(axis=0)[1:]])
        scatter, correlation = before[: -settings.gap].var(axis=0), self._correlation(before)
        if _elsewhere(before, after, settings.gap, scatter + floor**2):
            return None
        weights = sum(
            1 / np.maximum(1.0, len(part) * (1 - correlation) / (1 + correlation)) for part in (before, after)
        )
        losses, deviations, misfits = _explain(step, shares, weights * (scatter + floor**2), settings.model_error)
        likely = int(np.argmin(misfits))  # what the likeliest loss leaves is noise, too
        left = after[settings.gap :] + losses[likely] * each[settings.gap :, likely]
        scatter = np.maximum(scatter, left.var(axis=0))
        variance = weights * (scatter + floor**2)
        losses, deviations, misfits = _explain(step, shares, variance, settings.model_error)
        possible = np.flatnonzero(losses > 0)
        if not len(possible):
            return None
        best = int(possible[np.argmin(misfits[possible])])
        # a centre of mass that shifts gives the moments without the thrust, a payload the thrust without the moments
        others = [*(misfits[i] for i in possible if i != best), step[0] ** 2 / variance[0]]
        others.append(float(np.sum(step[1:] ** 2 / variance[1:])))
        # what was there before goes with the thrust, where it is a centre of mass, a mass or a bent propeller
        thrust = float(each[..., 0].sum(axis=1).mean() / self._shares[oldest:end, :, 0].sum(axis=1).mean())
        others.append(float(np.sum((step - (thrust - 1) * before.mean(axis=0)) ** 2 / variance)))
        loss = RotorLoss(best, float(losses[best]), float(deviations[best]))
        named = (
            loss.share >= settings.smallest
            and loss.share >= settings.significance * loss.deviation
            and misfits[best] <= settings.fit
            and min(others) - misfits[best] >= settings.rival
        )
        return loss if named else None

    def _correlation(self, blocks: Floats) -> Floats:
        """(3,) correlation of a block with the next one, by which means are less certain than of white noise."""
        away = blocks - blocks.mean(axis=0)
        square = np.maximum(np.mean(away**2, axis=0), 1e-12)
        correlation = np.mean(away[1:] * away[:-1], axis=0) / square
        return np.asarray(np.clip(correlation, self._settings.correlation, 0.99))


def _elsewhere(before: Floats, after: Floats, edge: int, variance: Floats) -> bool:
    """Whether a step is inside of one of two windows (n, 3), where it would pass for noise, which any rotor explains.

    edge: blocks of each that are next to the other. variance: (3,) of a block.
    """
    step = (after.mean(axis=0) - before.mean(axis=0)) / variance
    last, first = before[-edge:].mean(axis=0), after[:edge].mean(axis=0)
    half = 0.5 * float(step @ (after.mean(axis=0) - before.mean(axis=0)))
    return bool(step @ (last - before.mean(axis=0)) > half or step @ (first - before.mean(axis=0)) < half)


def _explain(step: Floats, shares: Floats, variance: Floats, model_error: float) -> tuple[Floats, Floats, Floats]:
    """Of each rotor the loss that explains a step (3,) best, its standard deviation, and the chi-square left.

    shares: (n, 3). variance: (3,) of the step. model_error: share by which `shares` may be wrong.
    """
    information = np.sum(shares**2 / variance, axis=1)
    losses = -(shares / variance) @ step / information
    spread = variance + (model_error * losses[:, None] * shares) ** 2
    misfits = np.sum((step + losses[:, None] * shares) ** 2 / spread, axis=1)
    return losses, np.sqrt(1 / information + (model_error * losses) ** 2), misfits
