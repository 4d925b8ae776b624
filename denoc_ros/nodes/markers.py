"""Deflected centre lines for RViz: one line strip per link."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from denoc_ros.bags.cdr import stamp_fields
from denoc_ros.dynamics.elastic.deflection import CentreLine
from denoc_ros.dynamics.robot import Robot
from denoc_ros.model.beams.segments import whole_beams
from denoc_ros.nodes.base.messages import STAMP, template
from denoc_ros.types import Array

STATIONS = 13
WIDTH = 0.02  # m
MARKED = 999_999_001  # s and ns of a stamp whose place is looked for
Line = tuple[str, bool, Array]  # of a link, whether it is flexible, points (k, 3)
RIGID, FLEXIBLE = (0.35, 0.38, 0.42), (0.85, 0.33, 0.10)


class CentreLines:
    """Centre lines of a robot's links, from its coordinates.

    A rigid link is drawn from its frame to the frames that hang on it, a flexible one along its
    deflected beam.

    Parameters
    ----------
    robot : Robot
        Its own copy: not shared with another thread.
    """

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
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

    def points(self, q: Array) -> list[Line]:
        """Return link, whether flexible, and points (k, 3) [m, base frame] of every line."""
        lines: list[Line] = []
        for body, children in self._lines:
            pose = self._robot.frame_pose(body.name, q)
            beam = self._beams.get(body.name)
            if beam is not None:
                lines.append((body.name, True, _in_base(pose @ body.frame, beam.points(q))))
                continue
            ends = [self._robot.frame_pose(child, q)[:3, 3] for child in children]
            strip = [point for end in ends for point in (pose[:3, 3], end)]
            if strip:
                lines.append((body.name, False, np.array(strip)))
        return lines


class LineMarkers:
    """The markers of centre lines as bytes: laid out once, then only written into.

    Parameters
    ----------
    frame_id : str
        The base frame.
    """

    def __init__(self, frame_id: str) -> None:
        self._frame_id = frame_id
        self._layout: list[tuple[str, bool, int]] | None = None
        self._raw = bytearray()
        self._stamps: list[int] = []  # where they stand
        self._points: list[Array] = []  # views of all coordinates of a line

    def encode(self, lines: Sequence[Line], stamp_ns: int) -> bytes:
        """Return a MarkerArray of lines, as `CentreLines.points` returns them."""
        layout = [(link, flexible, len(points)) for link, flexible, points in lines]
        if layout != self._layout:
            self._lay_out(layout)
        seconds, nanoseconds = stamp_fields(stamp_ns)
        for at in self._stamps:
            STAMP.pack_into(self._raw, at, seconds, nanoseconds)
        for place, (_, _, points) in zip(self._points, lines, strict=True):
            place[:] = points.ravel()
        return bytes(self._raw)

    def _lay_out(self, layout: list[tuple[str, bool, int]]) -> None:
        stamps = [(MARKED + number, MARKED) for number in range(len(layout))]
        firsts = [1.2345e100 + number * 1e90 for number in range(len(layout))]
        array = MarkerArray()
        for number, (link, flexible, count) in enumerate(layout):
            seconds, nanoseconds = stamps[number]
            marker = Marker()
            marker.header.frame_id = self._frame_id
            marker.header.stamp = Time(sec=seconds, nanosec=nanoseconds)
            marker.ns, marker.id = link, number
            marker.type, marker.action = Marker.LINE_STRIP, Marker.ADD
            marker.pose.orientation.w = 1.0
            marker.scale.x = WIDTH
            red, green, blue = FLEXIBLE if flexible else RIGID
            marker.color = ColorRGBA(r=red, g=green, b=blue, a=1.0)
            marker.points = [Point(x=firsts[number])] + [Point() for _ in range(count - 1)]
            array.markers.append(marker)
        self._raw, offsets = template(array, firsts)
        # what arrives is what was sent: the middleware would pad it to that
        self._raw += bytes(-len(self._raw) % 4)
        self._stamps = [self._raw.index(STAMP.pack(*stamp)) for stamp in stamps]
        self._points = [
            np.frombuffer(self._raw, '<f8', 3 * count, offset)
            for offset, (_, _, count) in zip(offsets, layout, strict=True)
        ]
        self._layout = layout


def _in_base(pose: Array, points: Array) -> Array:
    """Return points (k, 3) of a frame with a pose (4, 4) in the base frame."""
    return np.asarray(points @ pose[:3, :3].T + pose[:3, 3])
