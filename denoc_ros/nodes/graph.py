"""Clean removal of a process from the ROS graph."""

from __future__ import annotations

import gc

import rclpy


def leave_graph() -> None:
    """Destroy the default context, which ends the last of the middleware's threads.

    All nodes must have been destroyed. A thread that is alive when the process exits may still
    be at work on what is being freed.
    """
    context = rclpy.get_default_context()
    rclpy.try_shutdown()
    context.destroy()
    gc.collect()
