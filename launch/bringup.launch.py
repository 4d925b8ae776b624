"""Feedforward and predictor on a robot: ros2 launch denoc_ros bringup.launch.py urdf:=ROBOT."""

from __future__ import annotations

from typing import Any

from denoc_ros.nodes import launching


def generate_launch_description() -> Any:
    """Return the launch description."""
    return launching.description(
        ('predictor', 'feedforward'),
        launching.RECORD,
        launching.OUTPUT,
        launching.VIEWER,
        launching.RVIZ,
    )
