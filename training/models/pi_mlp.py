"""PI-MLP: PI-TCN's decoder alone, on one column by default, with the physics-inspired loss."""

from training.config import ModelConfig
from training.models.kind import Kind

MODEL = Kind(
    "pi_mlp",
    "a perceptron on the newest column with the physics-inspired loss",
    ModelConfig("pi_mlp", "mlp", history=1),
    has_physics_loss=True,
    recipe={"physics_points": "space", "physics_weight": 1.0},
)
