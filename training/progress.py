"""Progress of a member, and the state file from which it continues after it was killed."""

from __future__ import annotations

import copy
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch
from torch import nn

from dynamics.errors import RequestError
from training.checkpoint import read_content, write_atomically
from training.optimiser import StepRule


@dataclass(eq=False)
class Run:
    """All state of a training in progress.

    rule: the optimisers.
    generator: of batches and noise; dropout takes torch's own.
    fingerprint: of everything that determines the result.
    best, best_step, best_weights: of the lowest validation error.
    without_better: evaluations since then.
    seconds: of training.
    """

    network: nn.Module
    rule: StepRule
    generator: torch.Generator
    fingerprint: str
    step: int = 0
    best: float = float("inf")
    best_step: int = 0
    best_weights: dict[str, Any] = field(default_factory=dict)
    without_better: int = 0
    seconds: float = 0.0

    def keep_best(self, validation: float) -> None:
        """Remember the weights if they are the best so far."""
        if validation < self.best:
            self.best, self.best_step, self.without_better = validation, self.step, 0
            self.best_weights = copy.deepcopy(self.network.state_dict())
        else:
            self.without_better += 1

    def is_exhausted(self, patience: int) -> bool:
        """Whether `patience` evaluations in a row were no better than the best one. patience: 0 for never."""
        return 0 < patience <= self.without_better

    def save(self, path: Path) -> None:
        """Write all of it. Raises RequestError when the disk refuses."""
        on_gpu = next(self.network.parameters()).is_cuda
        content = {name: getattr(self, name) for name in PLAIN}
        content |= {
            "network": self.network.state_dict(),
            "optimiser": self.rule.state(),
            "generator": self.generator.get_state(),
            "random": torch.get_rng_state(),
            "cuda_random": torch.cuda.get_rng_state() if on_gpu else None,
        }
        write_atomically(content, path)

    def resume(self, path: Path) -> None:
        """Continue from a saved state. Raises RequestError for a damaged file or one of another training."""
        content = read_content(path)
        if content.get("fingerprint") != self.fingerprint:
            raise RequestError(
                f"{path} is of another training: flights, options, seed or versions differ. Give the same command as "
                f"before with --resume, or delete {path.parent}."
            )
        for name in PLAIN:
            setattr(self, name, content[name])
        self.network.load_state_dict(content["network"])
        self.rule.restore(content["optimiser"])
        self.generator.set_state(content["generator"])
        torch.set_rng_state(content["random"])
        if content["cuda_random"] is not None:
            torch.cuda.set_rng_state(content["cuda_random"])


PLAIN = ("fingerprint", "step", "best", "best_step", "best_weights", "without_better", "seconds")
