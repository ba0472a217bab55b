"""One reader a format: `matches` recognises its content, `read` converts it to streams in our units and frames."""
