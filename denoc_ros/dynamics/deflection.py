"""Deflection of the beams' tips from the amplitudes: all flexible links in one call."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from denoc_ros.dynamics.section import ComponentSection, SegmentedSection
from denoc_ros.kernels.compiled import ready
from denoc_ros.kernels.tip_deflection import ROTATIONS, segmented_tip, tip_deflections
from denoc_ros.model.segments import whole_beams
from denoc_ros.types import Array

if TYPE_CHECKING:
    from denoc_ros.dynamics.robot import Robot


COMPONENTS = ('ux', 'uy', 'uz', 'rx', 'ry', 'rz')


class TipDeflections:
    """Displacement and rotation of every flexible link's tip, and their rates.

    Parameters
    ----------
    robot : Robot

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
