"""The version of Alula, which every artefact records."""

__version__ = "0.1.0"
