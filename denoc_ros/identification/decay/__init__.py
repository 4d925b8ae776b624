"""Modes and damping of recorded signals."""
