"""Grey box + residual: the vehicle file's named effects first, temporal convolutions on their residual.

The residual is force and torque in body axes, as in supplement eq. 1 but on the vehicle file's model, hidden states
included, and is trained not to respond to pulses on the rotors, which the effects do. Where the ensemble disagrees more
than on its validation flights the residual fades and the named effects remain.
"""

from training.config import ModelConfig
from training.models.kind import Kind

MODEL = Kind(
    "grey_box", "the vehicle file's effects, and a network on their residual",
    ModelConfig("grey_box", "tcn", base="grey_box", outputs="wrench"),
    recipe={"physics_points": "pulses", "physics_weight": 4.0, "physics_start": 0.0, "physics_batch": 64},
)  # fmt: skip
