"""The urgent half of a tick in C: `alula_tick` (tick.h), and a thread of its own that answers a vehicle's estimates."""
