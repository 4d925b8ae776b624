"""Replay: torque and deflection recomputed along a recorded motion, beside the measured ones."""
