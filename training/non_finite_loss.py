"""Which flight made a loss that is no number."""

from __future__ import annotations

import torch
from torch import Tensor

from dynamics.errors import DataError
from training.data.dataset import RowNames
from training.data.tensors import Tensors


def blame(rows: RowNames, tensors: Tensors, chosen: Tensor, *, step: int, batch: int) -> DataError:
    """The error that says in which batch and at which flight's row learning broke down.

    A window or a label whose square is no number in 32 bits is named; without one the weights have diverged, and
    the window with the largest standardised value in the batch is.
    """
    ends = tensors.ends[chosen.to(tensors.ends.device)]
    sizes = torch.cat([tensors.windows(ends).flatten(1), tensors.targets[ends]], dim=1).abs()
    largest = sizes.nan_to_num(nan=torch.inf).amax(dim=1)
    worst = int(largest.argmax())
    row = int(ends[worst])
    where = f"{rows.flight_at(row)} at {rows.time[row]:.2f} s"
    head = f"the loss of batch {step} ({batch} windows) is no number"
    if not torch.isfinite(largest[worst].square()):
        return DataError(
            f"{head}: {where} has a value that is none, or far too large. Leave the flight out, or repair its log."
        )
    return DataError(
        f"{head}: the weights diverged; the most extreme window of the batch, {float(largest[worst]):.3g} standard "
        f"deviations, is of {where}. Look at that flight with `alula inspect`, or lower --learning-rate."
    )
