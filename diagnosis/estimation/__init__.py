"""Parameters of chosen effects: equation error, output error, acceptance by errors on held-out flights."""
