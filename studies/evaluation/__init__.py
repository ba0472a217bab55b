"""Models on flights that they were not trained on, as tables, pictures and a page."""
