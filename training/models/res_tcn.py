"""RES-TCN: PI-TCN's network as residual force and torque inside the nominal model (supplement eq. 1)."""

from training.config import ModelConfig
from training.models.kind import Kind

MODEL = Kind(
    "res_tcn",
    "residual force and torque on the nominal model",
    ModelConfig("res_tcn", "tcn", base="nominal", outputs="wrench"),
)
