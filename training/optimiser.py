"""The optimiser of a recipe: Adam for everything, or Muon for the weight matrices and Adam for the rest.

Muon (K. Jordan et al., 2024) makes a step of a matrix equally long along all of its directions. The networks here have
to find accelerations in small differences of neighbouring columns, directions along which gradients are weak: after the
same steps Muon errs by less than half as much as Adam (docs/decisions/training.md).
"""

from __future__ import annotations

from typing import Any

from torch import nn
from torch.optim import Adam, Muon, Optimizer

from training.recipe import Recipe


class StepRule:
    """Optimisers of all parameters as one. Its state is a plain dictionary, from which a training continues."""

    def __init__(self, network: nn.Module, recipe: Recipe) -> None:
        self._parts: list[tuple[Optimizer, float]] = []
        if recipe.optimiser == "adam":
            self._parts.append((Adam(network.parameters(), fused=True), 1.0))
            return
        matrices = [parameter for parameter in network.parameters() if parameter.ndim == 2]
        others = [parameter for parameter in network.parameters() if parameter.ndim != 2]
        # "match_rms_adamw": rates mean the same as Adam's
        muon = Muon(matrices, weight_decay=0.0, adjust_lr_fn="match_rms_adamw")
        self._parts += [(muon, recipe.matrix_rate), (Adam(others, fused=True), 1.0)]

    def step(self, learning_rate: float) -> None:
        """One step along the current gradients."""
        for optimiser, factor in self._parts:
            for group in optimiser.param_groups:
                group["lr"] = factor * learning_rate
            optimiser.step()

    def clear_gradients(self) -> None:
        """Set all gradients to zero."""
        for optimiser, _ in self._parts:
            optimiser.zero_grad()

    def state(self) -> list[dict[str, Any]]:
        """State that `restore` takes."""
        return [optimiser.state_dict() for optimiser, _ in self._parts]

    def restore(self, state: list[dict[str, Any]]) -> None:
        """Continue from a saved state of the same recipe and network."""
        for (optimiser, _), saved in zip(self._parts, state, strict=True):
            optimiser.load_state_dict(saved)
