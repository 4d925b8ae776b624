"""Replay: torque and deflection of a recorded motion, computed anew beside what was measured."""
