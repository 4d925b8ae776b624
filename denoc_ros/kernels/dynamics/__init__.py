"""Inverse, forward and hybrid dynamics of trees; steps of time."""
