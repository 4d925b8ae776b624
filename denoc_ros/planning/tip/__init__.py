"""Motions with the tip on its path."""
