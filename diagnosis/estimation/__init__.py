"""Parameters of chosen effects: equation error, output error, errors on held-out flights."""
