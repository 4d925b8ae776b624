"""The desired motion."""
