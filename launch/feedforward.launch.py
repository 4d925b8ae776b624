"""The feedforward node on a robot: ros2 launch denoc_ros feedforward.launch.py urdf:=ROBOT."""

from __future__ import annotations

from typing import Any

from denoc_ros.nodes import launching


def generate_launch_description() -> Any:
    """Return the launch description."""
    return launching.description(('feedforward',), file='feedforward.yaml')
