"""MSE-TCN: PI-TCN without the physics-inspired loss, lambda = 0 (supplement, section Baselines)."""

from training.config import ModelConfig
from training.models.kind import Kind

MODEL = Kind("mse_tcn", "PI-TCN's network on data alone", ModelConfig("mse_tcn", "tcn"))
