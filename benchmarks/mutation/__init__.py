"""Mutation testing: which of the mutants of a tree the tests kill."""
