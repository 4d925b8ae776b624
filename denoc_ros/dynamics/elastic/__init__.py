"""Deflections, and bounds of the elastic state."""
