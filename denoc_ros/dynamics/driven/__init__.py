"""Robots driven by their joints: motions, limits, torque."""
