"""How a model is trained. `PAPER` is the paper to the letter, `FAST` the default, sized for two cores."""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from dynamics.errors import RequestError
from dynamics.spelling import unknown

Share = Annotated[float, Meta(ge=0, le=1)]
Positive = Annotated[float, Meta(gt=0)]
Count = Annotated[int, Meta(ge=1)]


class Recipe(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Optimiser, schedule and loss.

    steps: of the optimiser.
    epochs: over the training windows, instead of steps.
    batch: windows a step.
    optimiser: Adam, or Muon for weight matrices (`training.optimiser`).
    learning_rate: the highest; it starts at a tenth, rises over warm_up and falls to a thousandth along a cosine.
    matrix_rate: factor on learning_rate for the matrices that Muon steps.
    constant_rate: learning_rate at every step.
    warm_up: share of a stage.
    standardise: inputs and outputs to mean 0 and deviation 1.
    physics_weight: lambda of PI-TCN eq. 4, 0 in a first stage; then optimiser and schedule restart with it.
    physics_start: share of the steps in the first stage.
    annealed: whether lambda then falls to 0 linearly.
    physics_points: collocation points (`training.data.collocation`): "space", anywhere in the state-input space, as the
        paper's; "plausible", recorded motion scaled by 1 to 1.6 under recorded commands, simulated with the nominal
        model; "pulses" on the rotors of recorded motion, with the response of the vehicle file's model.
    physics_batch: points a step.
    physics_pool: points drawn beforehand, in batches taken in turn; the paper draws one batch.
    rollout: steps of dt that the network is streamed over with its own predictions as inputs, 1 for none.
    input_noise: deviation added to the standardised measured state, never to the rotors (`training.data.tensors`).
    evaluate_every: steps between evaluations on the validation flights.
    patience: evaluations without a better one after which a member stops, 0 for never; it keeps the best one.
    """

    name: str = "fast"
    steps: Count = 10_000
    epochs: Count | None = None
    batch: Count = 256
    optimiser: Literal["adam", "muon"] = "muon"
    learning_rate: Positive = 3e-3
    matrix_rate: Positive = 2.0
    constant_rate: bool = False
    warm_up: Share = 0.1
    standardise: bool = True
    physics_weight: Annotated[float, Meta(ge=0)] = 0.0
    physics_start: Share = 0.5
    annealed: bool = False
    physics_points: Literal["space", "plausible", "pulses"] = "plausible"
    physics_batch: Count = 64
    physics_pool: Count = 16_384
    rollout: Count = 1
    input_noise: Annotated[float, Meta(ge=0)] = 0.0
    evaluate_every: Count = 1000
    patience: Annotated[int, Meta(ge=0)] = 0


PAPER = Recipe(
    name="paper", epochs=10_000, batch=1024, optimiser="adam", learning_rate=1e-4, constant_rate=True,
    standardise=False, physics_weight=1.0, physics_points="space", physics_batch=1024, physics_pool=1024,
    evaluate_every=5000,
)  # fmt: skip
FAST = Recipe()
RECIPES = {"paper": PAPER, "fast": FAST}


def named_recipe(name: str) -> Recipe:
    """The recipe of a name. Raises RequestError for another."""
    if name not in RECIPES:
        raise RequestError(f"unknown recipe {name!r}{unknown(name, RECIPES)}")
    return RECIPES[name]
