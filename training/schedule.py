"""Stages, learning rate and lambda as functions of the step alone, so that a resumed run continues unchanged."""

from __future__ import annotations

import math
from dataclasses import dataclass

from training.recipe import Recipe

START, END = 0.1, 0.001  # of the highest learning rate


@dataclass(frozen=True)
class Schedule:
    """A recipe over a number of steps.

    steps: in all.
    restart: the step at which lambda begins and optimiser and schedule restart; none if equal to steps.
    """

    recipe: Recipe
    steps: int
    restart: int

    @classmethod
    def of(cls, recipe: Recipe, windows: int) -> Schedule:
        """The schedule of a recipe on so many training windows."""
        steps = recipe.steps
        if recipe.epochs is not None:
            steps = recipe.epochs * max(1, math.ceil(windows / recipe.batch))
        restart = round(recipe.physics_start * steps) if recipe.physics_weight > 0 else steps
        return cls(recipe, steps, restart)

    def starts_anew(self, step: int) -> bool:
        """Whether optimiser and learning rate start or restart at this step."""
        return step == 0 or (step == self.restart and step < self.steps)

    def learning_rate(self, step: int) -> float:
        """Linear warm-up, then a cosine; within each stage by itself."""
        recipe = self.recipe
        if recipe.constant_rate:
            return recipe.learning_rate
        first, last = (0, self.restart) if step < self.restart else (self.restart, self.steps)
        passed = (step - first) / (last - first)
        if passed < recipe.warm_up:
            return recipe.learning_rate * (START + (1 - START) * passed / recipe.warm_up)
        cosine = 0.5 * (1 + math.cos(math.pi * (passed - recipe.warm_up) / (1 - recipe.warm_up)))
        return recipe.learning_rate * (END + (1 - END) * cosine)

    def physics_weight(self, step: int) -> float:
        """lambda (eq. 4): 0 in the first stage."""
        if step < self.restart:
            return 0.0
        left = (self.steps - step) / (self.steps - self.restart)
        return self.recipe.physics_weight * (left if self.recipe.annealed else 1.0)
