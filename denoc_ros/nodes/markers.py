"""Deflected centre lines for RViz: one line strip per link."""

from __future__ import annotations

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from denoc_ros.bags.cdr import stamp_fields
from denoc_ros.dynamics.centre_line import CentreLine
from denoc_ros.dynamics.robot import Robot
from denoc_ros.model.segments import whole_beams
from denoc_ros.types import Array

STATIONS = 13
WIDTH = 0.02  # m
RIGID, FLEXIBLE = (0.35, 0.38, 0.42), (0.85, 0.33, 0.10)


class CentreLines:
    """Centre lines of a robot's links, from its coordinates.

    A rigid link is drawn from its frame to the frames that hang on it, a flexible one along its
    deflected beam.

    Parameters
    ----------
    robot : Robot
        Its own copy: not shared with another thread.
    frame_id : str
        The base frame.
    """

    def __init__(self, robot: Robot, frame_id: str) -> None:
        self._robot = robot
        self._frame_id = frame_id
        tree = robot.tree
        self._lines = [
            (
                body,
                [
                    child.name
                    for child in tree.bodies
                    if child.attachment.body == index and child.segment == 1
                ],
            )
            for index, body in enumerate(tree.bodies)
            if body.segment == 1
        ]
        self._beams = {
            beam.link: CentreLine(robot, beam.link, np.linspace(0.0, beam.length, STATIONS))
            for beam in whole_beams(tree)
        }

    def points(self, q: Array) -> list[tuple[str, bool, Array]]:
        """Return link, whether flexible, and points (k, 3) [m, base frame] of every line."""
        lines = []
        for body, children in self._lines:
            pose = self._robot.frame_pose(body.name, q)
            beam = self._beams.get(body.name)
            if beam is not None:
                lines.append((body.name, True, _in_base(pose @ body.frame, beam.place(q)[0])))
                continue
            ends = [self._robot.frame_pose(child, q)[:3, 3] for child in children]
            strip = [point for end in ends for point in (pose[:3, 3], end)]
            if strip:
                lines.append((body.name, False, np.array(strip)))
        return lines

    def message(self, q: Array, stamp_ns: int) -> MarkerArray:
        """Return the markers at coordinates (n,)."""
        seconds, nanoseconds = stamp_fields(stamp_ns)
        array = MarkerArray()
        for number, (link, flexible, points) in enumerate(self.points(q)):
            marker = Marker()
            marker.header.frame_id = self._frame_id
            marker.header.stamp = Time(sec=seconds, nanosec=nanoseconds)
            marker.ns, marker.id = link, number
            marker.type, marker.action = Marker.LINE_STRIP, Marker.ADD
            marker.pose.orientation.w = 1.0
            marker.scale.x = WIDTH
            red, green, blue = FLEXIBLE if flexible else RIGID
            marker.color = ColorRGBA(r=red, g=green, b=blue, a=1.0)
            marker.points = [Point(x=x, y=y, z=z) for x, y, z in points.tolist()]
            array.markers.append(marker)
        return array


def _in_base(pose: Array, points: Array) -> Array:
    """Return points (k, 3) of a frame with a pose (4, 4) in the base frame."""
    return np.asarray(points @ pose[:3, :3].T + pose[:3, 3])
