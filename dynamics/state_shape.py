"""How many states and inputs a model has."""

from __future__ import annotations

import numpy as np

from dynamics.arrays import Floats
from dynamics.state import RIGID_BODY_STATES
from dynamics.vehicle import Vehicle


class StateShape:
    """Counts of a model. vehicle: whose model it is. hidden_initial: hidden states in hover."""

    vehicle: Vehicle
    hidden_initial: Floats

    @property
    def state_count(self) -> int:
        """Length of the state, hidden states included."""
        return RIGID_BODY_STATES + self.hidden_count

    @property
    def hidden_count(self) -> int:
        """Number of hidden states."""
        return int(self.hidden_initial.size)

    @property
    def input_count(self) -> int:
        """Number of rotors."""
        return self.vehicle.rotors.count

    def initial_state(self, rigid_body: Floats) -> Floats:
        """The whole state for a rigid-body state (13,), with hidden states at their hover values."""
        return np.concatenate([rigid_body, self.hidden_initial])
