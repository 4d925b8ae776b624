"""Verbs of the part identification."""
