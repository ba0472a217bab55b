"""Reports as self-contained HTML pages with their pictures inside, which need no network."""
