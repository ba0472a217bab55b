"""Flights as a network learns them: labels, features, windows, tensors."""
