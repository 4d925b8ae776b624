"""A flexible link's centre line: where many of its cross-sections stand, all at once."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from denoc_ros.dynamics.rotations import rotations
from denoc_ros.dynamics.section import Section
from denoc_ros.dynamics.structure import whole_beam
from denoc_ros.model.segments import locate
from denoc_ros.types import Array

if TYPE_CHECKING:
    from denoc_ros.dynamics.robot import Robot


class CentreLine:
    """Cross-sections at given stations of a link, in its beam frame.

    Parameters
    ----------
    robot : Robot
    link : str
        A flexible one.
    stations : (s,) array
        On the whole beam [m].

    Attributes
    ----------
    stations : (s,) array
    segment : (s,) int array
        Which of the link's segments holds each, from 0.
    local : (s,) array
        Their stations on those segments [m].
    """

    def __init__(self, robot: Robot, link: str, stations: Array) -> None:
        whole = whole_beam(robot, link)
        stiff = robot.geometric_stiffness
        found = [locate(whole.length, whole.segments, float(x)) for x in stations]
        self.stations = stations
        self.segment = np.array([segment for segment, _ in found], dtype=np.intp)
        self.local = np.array([local for _, local in found])
        self._own, self._shape = robot.amplitudes(link), (whole.segments, whole.modes)
        self._length = whole.segment.length
        self._tips = [Section(beam, beam.length, stiff) for beam in whole.beams]
        sections = [
            Section(whole.beams[segment], local, stiff)
            for segment, local in zip(self.segment, self.local.tolist(), strict=True)
        ]
        self._linear = np.array([section.linear for section in sections])
        self._shortening = np.array([section.shortening for section in sections])

    def amplitudes(self, q: Array) -> Array:
        """Return the amplitudes (s, m) of the segments that hold the stations."""
        return np.asarray(q[self._own].reshape(self._shape)[self.segment])

    def place(self, q: Array) -> tuple[Array, Array]:
        """Return the points (s, 3) [m] and the turns (s, 3, 3) of the sections.

        Parameters
        ----------
        q : (n,) array
            Coordinates.
        """
        points, turns = self._in_segments(q)
        if self._shape[0] == 1:
            return points, turns
        roots, axes = self._roots(q)
        roots, axes = roots[self.segment], axes[self.segment]
        placed = roots + np.matmul(axes, points[:, :, None])[:, :, 0]
        return placed, np.matmul(axes, turns)

    def points(self, q: Array) -> Array:
        """Return the points (s, 3) [m] alone."""
        return self._sections(q)[0] if self._shape[0] == 1 else self.place(q)[0]

    def _in_segments(self, q: Array) -> tuple[Array, Array]:
        """Return points and turns, each in the frame of its segment."""
        points, bend = self._sections(q)
        return points, rotations(bend[:, 3:])

    def _sections(self, q: Array) -> tuple[Array, Array]:
        """Return points (s, 3), and displacements with rotation vectors (s, 6), in segments."""
        d = self.amplitudes(q)
        bend = np.matmul(self._linear, d[:, :, None])[:, :, 0]
        drawn = np.matmul(self._shortening, d[:, :, None])[:, :, 0]
        points = bend[:, :3].copy()
        points[:, 0] = self.local - 0.5 * np.sum(drawn * d, axis=1)
        return points, bend

    def _roots(self, q: Array) -> tuple[Array, Array]:
        """Return where the segments' frames stand in the beam frame, (k, 3) and (k, 3, 3)."""
        parts = q[self._own].reshape(self._shape)
        tips = np.array([tip.deflection(d) for tip, d in zip(self._tips, parts, strict=True)])
        turns = rotations(tips[:, 3:])
        tips[:, 0] += self._length
        count = self._shape[0]
        roots, axes = np.zeros((count, 3)), np.tile(np.eye(3), (count, 1, 1))
        for k in range(1, count):
            roots[k] = roots[k - 1] + axes[k - 1] @ tips[k - 1, :3]
            axes[k] = axes[k - 1] @ turns[k - 1]
        return roots, axes
