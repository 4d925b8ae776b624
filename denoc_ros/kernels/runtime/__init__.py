"""Computations of a tick beside the dynamics: messages, limits, tracking, faults."""
