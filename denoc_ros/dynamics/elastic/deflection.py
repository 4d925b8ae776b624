"""Deflections of flexible links from the amplitudes: tips in one call, points of centre lines."""

from __future__ import annotations

import numpy as np

from denoc_ros.dynamics.elastic.section import ComponentSection, Section, SegmentedSection
from denoc_ros.dynamics.robot import Robot
from denoc_ros.dynamics.rotations import rotations
from denoc_ros.dynamics.structure import whole_beam
from denoc_ros.kernels.dynamics.tip_deflection import ROTATIONS, segmented_tip, tip_deflections
from denoc_ros.kernels.jit.compiled import ready
from denoc_ros.model.beams.segments import locate, whole_beams
from denoc_ros.types import Array

COMPONENTS = ('ux', 'uy', 'uz', 'rx', 'ry', 'rz')


class TipDeflections:
    """Displacement and rotation of every flexible link's tip, and their rates.

    Attributes
    ----------
    links : tuple of str
        The flexible links, in coordinate order.
    names : tuple of str
        `link/ux` ... `link/rz`, six per link.

    Notes
    -----
    In the beam frame: u_y = s_y . d_y and u_z likewise, the foreshortening
    u_x = -(d_y^T H_y d_y + d_z^T H_z d_z) / 2 with H = int s' s'^T dx, and the section's rotation
    vector [beta, -u_z', u_y']. Those of a link's segments are composed.
    """

    def __init__(self, robot: Robot) -> None:
        beams = {beam.link for beam in whole_beams(robot.tree)}
        bodies = robot.tree.bodies
        self.links = tuple(
            body.name
            for body in bodies
            if body.name in beams or (body.modes is not None and body.modes.tip)
        )
        self.names = tuple(f'{link}/{part}' for link in self.links for part in COMPONENTS)
        n, count = robot.n, len(self.links)
        # first the rows of what is linear, then those of the shortening
        self._rows = np.zeros((6 * count + n, n))
        self._owner = np.zeros((count, n))  # -1/2 at a link's own amplitudes
        ready(tip_deflections)
        self._composed: list[tuple[slice, tuple[Array, Array, Array], slice]] = []
        self._frames: list[tuple[slice, ComponentSection, slice]] = []
        self._turns = np.zeros(ROTATIONS)
        linear, shortening = self._rows[: 6 * count], self._rows[6 * count :]
        for index, link in enumerate(self.links):
            tip, own = robot.section(link)
            if isinstance(tip, ComponentSection):
                self._frames.append((slice(6 * index, 6 * index + 6), tip, own))
                continue
            if isinstance(tip, SegmentedSection):
                self._composed.append((slice(6 * index, 6 * index + 6), tip.ends, own))
                continue
            linear[6 * index : 6 * index + 6, own] = tip.linear
            shortening[own, own] = tip.shortening
            self._owner[index, own] = -0.5
        if self._composed:
            ready(segmented_tip)

    def evaluate(
        self, q: Array, qd: Array, out: tuple[Array, Array] | None = None
    ) -> tuple[Array, Array]:
        """Return the deflections and their rates.

        Parameters
        ----------
        q, qd : (n,) arrays
            Coordinates and rates.
        out : pair of (6 k,) arrays, optional
            Written and returned: the two results.

        Returns
        -------
        pair of (6 k,) arrays
            In the order of `names`: [m, rad] and [m/s, rad/s], beam frames.
        """
        size = len(self.names)
        position, rate = (np.empty(size), np.empty(size)) if out is None else out
        tip_deflections(self._rows, self._owner, q, qd, position, rate)
        for part, ends, own in self._composed:
            segmented_tip(*ends, q[own], qd[own], self._turns, position[part], rate[part])
        for part, frame, own in self._frames:
            position[part], rate[part] = frame.deflection(q[own]), frame.rate(q[own], qd[own])
        return position, rate


class CentreLine:
    """Cross-sections at given stations of a link, in its beam frame.

    Parameters
    ----------
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
