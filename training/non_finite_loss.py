"""The error for a loss that is not finite, with the flight that it comes from."""

from __future__ import annotations

import torch
from torch import Tensor

from dynamics.errors import DataError
from training.data.labelled_rows import RowNames
from training.data.tensors import Tensors


def non_finite_loss(rows: RowNames, tensors: Tensors, chosen: Tensor, *, step: int, batch: int) -> DataError:
    """The error that names batch, flight and time.

    The row is that of a window or label whose square is not finite in 32 bits; without one the weights have diverged,
    and it is that of the window with the largest standardised value in the batch.
    """
    ends = tensors.ends[chosen.to(tensors.ends.device)]
    sizes = torch.cat([tensors.windows(ends).flatten(1), tensors.targets[ends]], dim=1).abs()
    largest = sizes.nan_to_num(nan=torch.inf).amax(dim=1)
    worst = int(largest.argmax())
    row = int(ends[worst])
    where = f"{rows.flight_at(row)} at {rows.time[row]:.2f} s"
    head = f"the loss of batch {step} ({batch} windows) is not finite"
    if not torch.isfinite(largest[worst].square()):
        return DataError(
            f"{head}: {where} has a value that is not finite, or far too large. Leave the flight out, or "
            "repair its log."
        )
    return DataError(
        f"{head}: the weights diverged; the most extreme window of the batch, {float(largest[worst]):.3g} standard "
        f"deviations, is of {where}. Look at that flight with `alula inspect`, or lower --learning-rate."
    )
