"""Like sim.launch.py, recorded into the folder `run`, or `run_` and the time if that exists."""

from __future__ import annotations

from typing import Any

from denoc_ros.nodes import launching


def generate_launch_description() -> Any:
    """Return the launch description."""
    return launching.simulation(record='true', output='run')
