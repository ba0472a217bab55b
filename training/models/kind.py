"""A kind of model: its default definition and recipe, and those of the paper."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import msgspec

from training.config import ModelConfig
from training.recipe import Recipe


@dataclass(frozen=True)
class Kind:
    """A kind of model.

    config: with causal body-frame inputs, for the recipe "fast".
    has_physics_loss: in the paper.
    recipe: overrides of recipes other than the paper's.
    """

    name: str
    summary: str
    config: ModelConfig
    has_physics_loss: bool = False
    recipe: Mapping[str, Any] = field(default_factory=dict)

    def config_for(self, recipe: Recipe) -> ModelConfig:
        """The definition under a recipe: the paper's own has world-frame inputs, batch norm and dropout.

        Its inputs and labels are filtered at 5 Hz both ways, its motors measured (PI-TCN section IV).
        """
        if recipe.name != "paper":
            return self.config
        convolutional = self.config.network == "tcn"
        return msgspec.structs.replace(
            self.config,
            inputs="world",
            outputs="wrench" if self.config.outputs == "wrench" else "world",
            motors="measured",
            label="instantaneous",
            filtered_inputs=True,
            batch_norm=convolutional,
            dropout=0.1 if convolutional else 0.0,
        )

    def recipe_for(self, recipe: Recipe) -> Recipe:
        """The recipe as this model takes it: the paper's without the physics-inspired loss where the model has none."""
        if recipe.name != "paper":
            return msgspec.structs.replace(recipe, **self.recipe)
        return recipe if self.has_physics_loss else msgspec.structs.replace(recipe, physics_weight=0.0)
