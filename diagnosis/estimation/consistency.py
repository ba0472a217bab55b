"""Has an effect one value? One of the right form has the same where it acts strongly and weakly, early and late.

A form that stands in for another one fits the stretches that dominate the fit and misses the rest: a drag that grows
with the speed, in place of one that does not, has a smaller coefficient the faster the vehicle flies; a constant that
stands in for what warms up has another value at the end of each flight.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from diagnosis.estimation.fit_equations import by_block
from diagnosis.estimation.fitted import Fit, coefficients
from diagnosis.estimation.significance import deviations_of
from diagnosis.selection.regression import Regression
from diagnosis.thresholds import DEFAULT, ConsistencyThresholds
from dynamics.arrays import Floats


@dataclass(frozen=True)
class Drift:
    """Difference of an effect's values between two parts of the flights.

    share: RMS of the whitened signal of the difference, beyond what other effects take up, over that of the effect, all
        of it: between two that resemble each other a small error of their form moves the values by much. On all rows.
    deviations: standard deviations of the difference from none.
    over_noise: RMS of that signal over the noise, as of one channel, in the half of the flights where it is less; 0 of
        other parts, of which one may hardly move as the other does.
    """

    share: float
    deviations: float
    over_noise: float = 0.0

    def matters(self, limits: ConsistencyThresholds = DEFAULT.consistency) -> bool:
        """Whether it is more than chance, and large."""
        return self.share > limits.max_drift and self.deviations > limits.deviations

    def refutes(self, limits: ConsistencyThresholds = DEFAULT.consistency) -> bool:
        """Whether it is so much that the effect is none of one value, whatever else the flights show."""
        return self.matters(limits) and self.deviations > limits.sure and self.over_noise > limits.min_over_noise


def drifts(regression: Regression, fitted: Fit, rows: Sequence[Floats]) -> dict[str, Drift]:
    """By key, the largest difference of each fitted effect that is more than chance, or else the largest.

    Compared are the blocks of time that carry half of its signal with the others, the flights that carry half of it
    with the others, and the first half of each flight with the second. All effects are free in both parts, those of
    commands with their prior. By the slopes of the regression about the fit.
    rows: (m, 12) residuals of the fit on the regression's segments.
    """
    if not fitted.candidates:
        return {}
    shared, commands = regression.shared, list(regression.shared.columns)
    where = [*(i for c in fitted.candidates for i in c.columns), *commands]
    prior = np.diag([0.0] * (len(where) - len(commands)) + shared.information.tolist())
    at_fit = np.concatenate([*(coefficients(fitted, c) for c in fitted.candidates), np.zeros(len(commands))])
    blocks = list(_blocks(regression, rows, where, at_fit))
    grams, products = np.array([b.gram for b in blocks]), np.array([b.product for b in blocks])
    early, limits = np.array([b.early for b in blocks]), regression.thresholds.consistency
    flight, count = np.array([b.flight for b in blocks]), regression.total / len(regression.noise.active)
    results, begin, of_commands = {}, 0, list(range(len(where) - len(commands), len(where)))
    for candidate in fitted.candidates:
        own = list(range(begin, begin + len(candidate.columns)))
        begin += len(own)
        theta = coefficients(fitted, candidate)
        power = np.einsum("i,bij,j->b", theta, grams[:, own][:, :, own], theta)
        strong = _strongest_half(power), _strongest_half(np.bincount(flight, power).astype(float))[flight]
        alone = [*own, *of_commands]
        unlike = [
            replace(_drift(grams, products, prior, own, alone, theta, part, count), over_noise=0.0) for part in strong
        ]
        parts = [*unlike, _drift(grams, products, prior, own, alone, theta, early, count)]
        results[candidate.key] = max(parts, key=lambda one: (one.refutes(limits), one.matters(limits), one.share))
    return results


@dataclass(frozen=True, eq=False)
class _Block:
    """Whitened normal equations (k, k) and (k,) of some columns in residuals.

    flight: the number of its log. early: whether it is in the first half of what is left out together.
    """

    gram: Floats
    product: Floats
    flight: int
    early: bool


def _blocks(regression: Regression, rows: Sequence[Floats], where: Sequence[int], at_fit: Floats) -> Iterator[_Block]:
    """The blocks, less what an estimator's error of velocity adds to them: it shrinks a drag most where motion is weak.

    at_fit: (k,) coefficients of the columns.
    """
    noise = regression.noise
    length = max(noise.order, round(regression.thresholds.equation_error.block * regression.rate))
    lengths, flown = Counter[int](), Counter[int]()
    logs = list(dict.fromkeys(segment.flight for segment in regression.segments))
    for flight, y in zip(regression.flight_of, rows, strict=True):
        lengths[flight] += len(y)
    for place, (segment, flight, y, columns) in enumerate(
        zip(regression.segments, regression.flight_of, rows, regression.columns, strict=True)
    ):
        white_y, white_x = noise.whiten(y), noise.whiten(columns[:, :, list(where)])
        starts = np.arange(0, len(white_y), length)
        grams = by_block(white_x, white_x, starts)
        products = by_block(white_x, white_y[:, :, None], starts)[:, :, 0]
        if regression.pose.there:
            y_error, x_error = regression.errors[place]
            of_columns = noise.whiten(np.asarray(x_error[:, :, list(where)], dtype=float))
            of_rows = noise.whiten(y_error) - of_columns @ at_fit
            grams = grams - by_block(of_columns, of_columns, starts)
            products = products - by_block(of_columns, of_rows[:, :, None], starts)[:, :, 0]
        for start, gram, product in zip(starts.tolist(), grams, products, strict=True):
            early = flown[flight] + start + length / 2 < lengths[flight] / 2
            yield _Block(gram, product, logs.index(segment.flight), early)
        flown[flight] += len(y)


def _drift(
    grams: Floats,
    products: Floats,
    prior: Floats,
    own: Sequence[int],
    alone: Sequence[int],
    theta: Floats,
    part: NDArray[np.bool_],
    count: float,
) -> Drift:
    """The difference of one effect between a part of the blocks and the rest.

    grams, products: (b, k, k) and (b, k) of blocks. own: its columns, at theta. alone: these and those of commands.
    part: (b,). count: rows of a channel.
    """
    if part.all() or not part.any():
        return Drift(0.0, 0.0)
    (one, one_spread), (other, other_spread) = (_solution(grams[some], products[some], prior) for some in (part, ~part))
    difference = (one - other)[own]
    everything = grams.sum(axis=0) + prior
    signal = _beyond(everything, own)
    size = float(theta @ _beyond(everything[np.ix_(alone, alone)], range(len(own))) @ theta)
    apart = max(float(difference @ signal @ difference), 0.0)
    deviations = deviations_of(difference, (one_spread + other_spread)[np.ix_(own, own)])
    shown = min(
        float(difference @ _beyond(grams[some].sum(axis=0) + prior, own) @ difference) / some.mean()
        for some in (part, ~part)
    )
    return Drift(float(np.sqrt(apart / max(size, 1e-300))), deviations, float(np.sqrt(max(shown, 0.0) / count)))


def _strongest_half(power: Floats) -> NDArray[np.bool_]:
    """(b,) whether a block, or flight, is among the strongest, which together have half of the power."""
    order = np.argsort(-power)
    before = np.cumsum(power[order]) - power[order]
    strong = np.zeros(len(power), dtype=bool)
    strong[order[before < power.sum() / 2]] = True
    return strong


def _solution(grams: Floats, products: Floats, prior: Floats) -> tuple[Floats, Floats]:
    """The step (k,) from the fit on some blocks, and its covariance (k, k) by their own scores."""
    gram = grams.sum(axis=0) + prior
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    inverse = np.linalg.pinv(gram / np.outer(scale, scale), rcond=1e-8) / np.outer(scale, scale)
    step = inverse @ products.sum(axis=0)
    scores = products - grams @ step
    return step, np.asarray(inverse @ (scores.T @ scores) @ inverse)


def _beyond(gram: Floats, own: Sequence[int]) -> Floats:
    """The normal equations of some columns beyond the others."""
    rest = [i for i in range(len(gram)) if i not in own]
    across = gram[np.ix_(rest, own)]
    return np.asarray(gram[np.ix_(own, own)] - across.T @ np.linalg.lstsq(gram[np.ix_(rest, rest)], across)[0])
