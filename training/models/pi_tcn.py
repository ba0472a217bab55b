"""PI-TCN: temporal convolutions over 20 columns, trained with the physics-inspired loss (section III)."""

from training.config import ModelConfig
from training.models.kind import Kind

MODEL = Kind(
    "pi_tcn",
    "temporal convolutions with the physics-inspired loss",
    ModelConfig("pi_tcn", "tcn"),
    has_physics_loss=True,
    recipe={"physics_points": "pulses", "physics_weight": 1.0, "input_noise": 0.3},
)
