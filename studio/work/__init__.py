"""Long work of a case in processes of its own, with progress and cancel."""
