"""Friction of a joint from a free swing."""
