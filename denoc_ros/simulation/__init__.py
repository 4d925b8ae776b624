"""Simulation: integrators over the dynamics, scenarios and runs."""
