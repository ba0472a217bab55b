"""Where the hidden states of an effect that may be missing begin: a log may start while a load swings already.

Gauss-Newton on what the model leaves of the first seconds' specific force, beside what else may be missing there: a
bias, a drag by axis and a share of the thrust. The effect has the strength that leaves least, which need not be right:
it is linear in that, and once it is fitted the starts are columns of the filter.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from diagnosis.likelihood.flight_rows import FlightRows
from diagnosis.likelihood.rigid_body import OUTPUTS, Along, FlightModel
from diagnosis.models.free_start import moved_start, posterior_step
from diagnosis.selection.candidates import Candidate
from diagnosis.thresholds import DEFAULT
from dynamics.arrays import Floats
from dynamics.effect import Effect
from dynamics.vehicle import GRAVITY, EffectUse, Vehicle


def beginning(
    candidate: Candidate,
    uses: Sequence[EffectUse],
    vehicle: Vehicle,
    catalogue: Mapping[str, Effect],
    rows: FlightRows,
    along: Along,
    *,
    all_of_it: bool = False,
) -> tuple[dict[str, float], float]:
    """Offsets from hover of a candidate's hidden states at a flight's start, by name, and the sum of squares of the
    specific force that is left of all of the flight, (m/s^2)^2. uses: of the model beside it.
    all_of_it: whether all of the flight shows them, and not its first seconds alone."""
    limits, usual = DEFAULT.prediction, candidate.effect.defaults(vehicle)

    def model_with(factor: float) -> FlightModel:
        strong = {name: candidate.at[name] + factor * (usual[name] - candidate.at[name]) for name in candidate.free}
        others = [use for use in uses if (use.name, use.rotor) != candidate.identity]
        return FlightModel(
            vehicle, [*others, EffectUse(candidate.effect.name, {**candidate.at, **strong}, candidate.rotor)], catalogue
        )

    model, count = model_with(1.0), max(1, round(limits.free_start_durations[-1] / rows.period))
    own = {name: std for name, (_, std) in model.hidden.starts.items() if name.rsplit(".", 1)[0] == candidate.key}
    base, left = _forces(rows, along)
    driving = model.driving(rows, along.reference)
    names, std = list(own), np.array(list(own.values()))

    def pushed(off: Floats, count: int = count) -> Floats:
        starts = dict(zip(names, off * std, strict=True))
        path = model.hidden_path(rows, driving[:count], starts)
        return model.outputs(rows, along, path)[:, OUTPUTS["force"]] - base[:count]

    off, errors = np.zeros(len(names)), _nuisances(along, base)
    if "rotor_speed" in rows.readings:
        push = pushed(off)
        factor = np.sum(push * left[:count]) / np.sum(push**2)
        model = model_with(float(np.clip(factor, *limits.free_start_strength)))
    for n in ([count, len(rows)] if all_of_it else [count]) * bool(own):
        for _ in range(limits.free_start_steps):
            here = pushed(off, n)
            step = limits.free_start_difference
            slopes = np.stack([(pushed(off + row, n) - here) / step for row in step * np.eye(len(off))], axis=2)
            change = posterior_step(np.concatenate([slopes, errors[:n]], axis=2), left[:n] - here, off)
            off = moved_start(off, change)
    columns = np.concatenate([pushed(off, len(rows))[:, :, None], errors], axis=2).reshape(-1, 8)
    y = left.ravel()
    rest = y - columns @ np.linalg.lstsq(columns, y, rcond=1e-9)[0] if np.isfinite(columns).all() else y
    return dict(zip(names, (off * std).tolist(), strict=True)), float(rest @ rest)


def _forces(rows: FlightRows, along: Along) -> tuple[Floats, Floats]:
    """(N, 3) specific force of the model, and what of that which was read, or which the velocity shows, it leaves."""
    if "accelerometer" in rows.readings:
        return along.force, rows.force - along.force
    slope = np.gradient(rows.velocity, rows.period, axis=0) + np.array([0, 0, GRAVITY])
    return along.force, np.einsum("tji,tj->ti", along.rotation, slope) - along.force


def _nuisances(along: Along, base: Floats) -> Floats:
    """(N, 3, 7) columns of a bias and a drag by axis, and of the thrust's error."""
    air, axes = np.einsum("tji,tj->ti", along.rotation, along.velocity), np.eye(3)
    bias = np.broadcast_to(axes, (len(base), 3, 3))
    return np.concatenate([bias, air[:, :, None] * axes, base[:, :, None]], axis=2)
