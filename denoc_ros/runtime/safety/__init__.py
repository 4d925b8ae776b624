"""Limits and safe torque."""
