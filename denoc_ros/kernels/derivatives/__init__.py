"""Derivatives of the dynamics of trees."""
