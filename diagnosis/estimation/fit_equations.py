"""Normal equations of a joint fit over blocks of time, and the covariance that the blocks' residuals give."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri, stdtrit

from diagnosis.selection.sensor_errors import Biases
from dynamics.arrays import Floats


@dataclass(frozen=True, eq=False)
class BlockRows:
    """A segment, whitened.

    flight: that it is of.
    y: (m, c) residuals.
    x, z: (m, c, k) slopes and instruments of the parameters, those of the biases behind them.
    starts: (b,) first rows of its blocks.
    error_gram, error_product: (b, k, k) and (b, k) what noise of the sensors' level adds to Z'X and Z'y of a block.
    """

    flight: int
    y: Floats
    x: Floats
    z: Floats
    starts: NDArray[np.intp]
    error_gram: Floats
    error_product: Floats

    def flat(self) -> tuple[Floats, Floats, Floats]:
        """Rows with time and channels in one axis: (m c,), (m c, k), (m c, k)."""
        width = self.x.shape[2]
        return self.y.ravel(), self.x.reshape(-1, width), self.z.reshape(-1, width)


@dataclass(frozen=True, eq=False)
class FitEquations:
    """Normal equations of parameters and biases behind them, a set for each flight.

    grams: Z'X. products: Z'y, both with errors-in-variables correction. instruments: Z'Z.
    rows: that they are summed over. cost: y'y.
    """

    grams: list[Floats]
    products: list[Floats]
    instruments: list[Floats]
    rows: list[BlockRows]
    biases: Biases
    cost: float

    def unbiased(self, part: BlockRows) -> Floats:
        """(m, c) residuals of a segment less the biases of its flight."""
        places = list(self.biases.columns)
        gram, product = self.grams[part.flight], self.products[part.flight]
        inner = gram[np.ix_(places, places)] + np.diag(self.biases.information)
        return np.asarray(part.y - part.x[:, :, places] @ np.linalg.solve(inner, product[places]))

    def scores(self, step: Floats, inverse: Floats) -> tuple[Floats, Floats]:
        """(k, k) covariance of the parameters' scores, summed over blocks of time, and (k,) how many these amount to.

        Biases are taken off the residuals, and what their priors leave unknown is added again.

        A block that carries much of an effect draws the fit to itself and leaves residuals that are too small; scores
        are divided by the root of what it leaves, to first order (MacKinnon and White, 1985, HC2). What is taken off
        for errors in variables is part of them. inverse: (k, k) of the normal equations.
        """
        count, biases = len(step), self.biases
        places = list(biases.columns)
        meat, shares, own_unknowns = np.zeros((count, count)), [], []
        for product, gram, instruments in zip(self.products, self.grams, self.instruments, strict=True):
            inner = instruments[np.ix_(places, places)] + np.diag(biases.information)
            off = np.linalg.solve(inner, product[places] - gram[np.ix_(places, range(count))] @ step)
            mixed = np.linalg.solve(inner, instruments[np.ix_(places, range(count))])
            own_unknowns.append((off, mixed))
            meat += mixed.T @ (biases.information[:, None] * mixed)
        for part in self.rows:
            off, mixed = own_unknowns[part.flight]
            residual = part.y - part.x[:, :, :count] @ step - part.x[:, :, places] @ off
            free = part.z[:, :, :count] - part.z[:, :, places] @ mixed
            scores = np.einsum("mck,mc->mk", free, residual)
            summed = np.add.reduceat(scores, part.starts, axis=0) - part.error_product + part.error_gram @ step
            own = by_block(free, part.x[:, :, :count], part.starts) - part.error_gram
            apart = np.linalg.solve(np.eye(count) - own @ inverse / 2, summed[:, :, None])[:, :, 0]
            meat += apart.T @ apart
            shares.append(np.einsum("jk,bkl,jl->bj", inverse, own, inverse))
        informed = np.maximum(np.concatenate(shares), 0.0)
        informed /= np.maximum(informed.max(axis=0, initial=0.0), 1e-300)  # where a fit diverges squares overflow
        return meat, informed.sum(axis=0) ** 2 / np.maximum((informed**2).sum(axis=0), 1e-300)


def pooled(model: Floats, blocks: Floats, number: Floats, prior: float) -> Floats:
    """The covariance (k, k) by the noise model, scaled to variances that blocks of residuals confirm.

    Where blocks vary more, the noise model is wrong, and theirs are the variances. Where they vary less, the model
    counts as some of them. Intervals of 95 % are 1.96 deviations for normal errors, whose variance is known; that of
    few blocks is not, for which deviations grow by Student's quantile over that.
    number: (k,) of blocks that inform of each parameter. prior: blocks that the model counts as.
    """
    ratio = np.diag(blocks) / np.maximum(np.diag(model), 1e-300)
    lower = (prior + number * ratio) / (prior + number)
    freedom = np.maximum(prior + number - 1, 2.0)
    wider = np.sqrt(np.maximum(ratio, lower)) * stdtrit(freedom, 0.975) / ndtri(0.975)
    return np.asarray(model * np.outer(wider, wider))


def by_block(left: Floats, right: Floats, starts: NDArray[np.intp]) -> Floats:
    """(b, k, l) products of (m, c, k) and (m, c, l) over the rows of each block."""
    parts = zip(np.split(left, starts[1:]), np.split(right, starts[1:]), strict=True)
    return np.stack([x.reshape(-1, x.shape[2]).T @ y.reshape(-1, y.shape[2]) for x, y in parts])


def explained_by_biases(gram: Floats, product: Floats, biases: Biases) -> float:
    """Gain of the biases of a flight in twice the log-likelihood. gram, product: of parameters and biases."""
    places = list(biases.columns)
    inner = gram[np.ix_(places, places)] + np.diag(biases.information)
    return float(product[places] @ np.linalg.solve(inner, product[places]))
