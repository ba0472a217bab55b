"""One reader a format: `matches` tells it by its content, `read` makes streams in our units and frames of it."""
