"""The physics of a multirotor, written once: frames, vehicle file, rotors, effects, integrators, references."""
