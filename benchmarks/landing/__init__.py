"""Whole flights from the ground to the ground: heights, crashes, landings, motors stopped in the air."""
