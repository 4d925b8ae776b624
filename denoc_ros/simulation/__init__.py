"""Simulation: integrators over the dynamics, trajectories, scenarios and runs."""
