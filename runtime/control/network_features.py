"""The inputs of a network's last layer, whitened by what it was trained on, as a bundle has them."""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dynamics.array_file import read_arrays
from dynamics.arrays import Floats
from dynamics.errors import RequestError

EXPORT_AGAIN = "Export the model again."


@dataclass(frozen=True, eq=False)
class NetworkFeatures:
    """Directions in which the training's inputs of the last layer varied most.

    projection: (k, n + 1) psi = projection (h, 1), with a mean of psi psi' over the training that is the identity.
    body: whether the network's linear outputs are in body axes, else the world's.
    """

    projection: Floats
    body: bool

    @property
    def rank(self) -> int:
        """k."""
        return len(self.projection)

    def of(self, last_input: Floats) -> Floats:
        """(k,) psi of inputs (n,) of the last layer."""
        return np.asarray(self.projection[:, :-1] @ last_input + self.projection[:, -1])


def whitened(moment: Floats, rank: int, *, body: bool) -> NetworkFeatures:
    """The features of a second moment (n + 1, n + 1) of (h, 1): its leading eigenvectors, at most `rank` of them."""
    values, vectors = np.linalg.eigh(moment)
    chosen = np.argsort(values)[::-1][:rank]
    chosen = chosen[values[chosen] > 1e-9 * values.max()]
    return NetworkFeatures(np.asarray(vectors[:, chosen].T / np.sqrt(values[chosen, None])), body)


def last_layer_file(moment: Floats, *, body: bool) -> bytes:
    """The bundle's file of a second moment."""
    file = io.BytesIO()
    np.savez(file, moment=moment, body=np.array(body))
    return file.getvalue()


def read_features(path: Path, rank: int) -> NetworkFeatures:
    """The features of a bundle's file. Raises RequestError for one that cannot be read."""
    content = read_arrays(path, advice=EXPORT_AGAIN)
    moment, body = content.get("moment", np.zeros(0)), content.get("body", np.zeros(0))
    if moment.ndim != 2 or moment.shape[0] != moment.shape[1] or not moment.size or body.size != 1:
        raise RequestError(f"cannot read {path}: it holds no square moment with its frame. {EXPORT_AGAIN}")
    if not np.isfinite(moment).all():
        raise RequestError(f"cannot read {path}: its moment is not finite. {EXPORT_AGAIN}")
    try:
        return whitened(moment.astype(float), rank, body=bool(body.item()))
    except ValueError as error:  # NumPy's, where no eigenvalues are found
        raise RequestError(f"cannot read {path}: {error}. {EXPORT_AGAIN}") from None
