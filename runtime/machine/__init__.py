"""The computer that flies: what of it a flight rests on, as `alula doctor` lists it."""
