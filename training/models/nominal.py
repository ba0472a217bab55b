"""NOM: the nominal model of the vehicle file, PI-TCN eq. 1 and 2. Nothing is trained."""

from training.config import ModelConfig
from training.models.kind import Kind

MODEL = Kind("nominal", "the nominal model, evaluated", ModelConfig("nominal", "none", base="nominal", history=1))
