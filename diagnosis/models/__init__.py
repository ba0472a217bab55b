"""A model along measured flights: one step ahead, over windows, and its derivatives."""
