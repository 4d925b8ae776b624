"""Compiled loops of the state feedback."""
