"""Layout of the rigid-body state vector, defined here alone.

x = (position_world m, velocity_world m/s, attitude quaternion body to world w first, rate_body rad/s); the hidden
states of effects follow. Row slices index the last axis of tables of states as well: `states[..., VELOCITY]`.
"""

POSITION = slice(0, 3)
VELOCITY = slice(3, 6)
ATTITUDE = slice(6, 10)
RATE = slice(10, 13)
RIGID_BODY_STATES = 13
HIDDEN = slice(RIGID_BODY_STATES, None)
