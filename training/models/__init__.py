"""The models by name: each module holds one `MODEL`, a definition for each recipe."""

from __future__ import annotations

from collections.abc import Mapping

from dynamics.errors import RequestError
from dynamics.spelling import unknown
from training.models import grey_box, mse_tcn, nominal, pi_mlp, pi_tcn, res_tcn, window_mlp
from training.models.kind import Kind

KINDS: Mapping[str, Kind] = {
    module.MODEL.name: module.MODEL for module in (nominal, pi_tcn, mse_tcn, res_tcn, pi_mlp, window_mlp, grey_box)
}


def named_kind(name: str) -> Kind:
    """The model of a name. Raises RequestError for another."""
    if name not in KINDS:
        raise RequestError(f"unknown model {name!r}{unknown(name, KINDS)}")
    return KINDS[name]
