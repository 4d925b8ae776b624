"""Tracking of numbers of a robot while it works."""
