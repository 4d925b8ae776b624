"""Deflected centre lines for RViz: one line strip per link."""

from __future__ import annotations

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point
from numpy.typing import NDArray
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from denoc_ros.dynamics.robot import Robot
from denoc_ros.model.tree import Body
from denoc_ros.runtime.stamps import stamp_fields

Array = NDArray[np.float64]

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
        names = [body.name for body in tree.bodies]
        self._lines = [
            (
                body,
                [
                    names[k]
                    for k, child in enumerate(tree.bodies)
                    if child.attachment.body == index
                ],
            )
            for index, body in enumerate(tree.bodies)
        ]
        self._beams = {
            body.name: _BeamLine(robot, body)
            for body in tree.bodies
            if body.beam is not None and any(body.beam.modes)
        }

    def points(self, q: Array) -> list[tuple[str, bool, Array]]:
        """Return link, whether flexible, and points (k, 3) [m, base frame] of every line."""
        lines = []
        for body, children in self._lines:
            pose = self._robot.frame_pose(body.name, q)
            beam = self._beams.get(body.name)
            if beam is not None:
                lines.append((body.name, True, beam.points(pose @ body.frame, q)))
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


class _BeamLine:
    """A beam's centre line: all stations in one product."""

    def __init__(self, robot: Robot, body: Body) -> None:
        assert body.beam is not None
        self._stations = np.linspace(0.0, body.beam.length, STATIONS)
        found = [robot.section(body.name, float(x)) for x in self._stations]
        self._amplitudes = found[0][1]
        self._linear = np.array([section.linear[:3] for section, _ in found])
        self._shortening = np.array([section.shortening for section, _ in found])

    def points(self, pose: Array, q: Array) -> Array:
        """Return the points (k, 3) [m, base frame] for the beam frame's pose (4, 4) there."""
        d = q[self._amplitudes]
        local = self._linear @ d
        local[:, 0] = self._stations - 0.5 * (self._shortening @ d @ d)
        return np.asarray(local @ pose[:3, :3].T + pose[:3, 3])
