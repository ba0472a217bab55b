"""Window MLP: one perceptron over a whole window, which four columns nearly exhaust (35 ms of motor lag)."""

from training.config import ModelConfig
from training.models.kind import Kind

MODEL = Kind("window_mlp", "a perceptron on a window", ModelConfig("window_mlp", "mlp", history=20))
