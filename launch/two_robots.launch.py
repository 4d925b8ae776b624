"""Two simulated robots: ros2 launch denoc_ros two_robots.launch.py urdf:=ROBOT.

All topics are relative, so `/arm1/reference` moves the one and `/arm2/reference` the other.
"""

from __future__ import annotations

from typing import Any

from denoc_ros.nodes import launching


def generate_launch_description() -> Any:
    """Return the launch description."""
    return launching.simulations(('arm1', 'arm2'))
