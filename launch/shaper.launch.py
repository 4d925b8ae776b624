"""The shaper node for a position-controlled arm: ros2 launch denoc_ros shaper.launch.py."""

from __future__ import annotations

from typing import Any

from denoc_ros.nodes import launching


def generate_launch_description() -> Any:
    """Return the launch description."""
    return launching.description(('shaper',), file='shaper.yaml')
