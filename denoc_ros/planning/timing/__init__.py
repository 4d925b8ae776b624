"""Timings of motions within limits."""
