"""Window MLP: one perceptron over a whole window of columns."""

from training.config import ModelConfig
from training.models.kind import Kind

MODEL = Kind("window_mlp", "a perceptron on a window", ModelConfig("window_mlp", "mlp", history=20))
