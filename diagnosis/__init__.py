"""Diagnosis: where a model fails, which physical effect is missing, and the model with it added."""
