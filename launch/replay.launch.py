"""Nodes on a recording: ros2 launch denoc_ros replay.launch.py bag:=BAG urdf:=ROBOT."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from denoc_ros.nodes import launching


def generate_launch_description() -> Any:
    """Return the launch description."""
    return launching.description(
        ('predictor', 'feedforward'),
        launching.BAG,
        launching.SPEED,
        launching.PLAYED_CLOCK,
        launching.RECORD,
        launching.OUTPUT,
        replace(launching.VIEWER, default='true'),
        launching.RVIZ,
        urdf=launching.ROBOT,
    )
