"""Recorded runs computed again."""
