"""Input shapers."""
