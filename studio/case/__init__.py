"""A case: logs, a vehicle, versions of its file and results, as a folder."""
