"""Parameters of chosen effects: equation error, acceptance by errors on held-out flights."""
