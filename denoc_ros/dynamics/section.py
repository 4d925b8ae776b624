"""Deflection of one cross-section of a beam, as a function of its link's amplitudes."""

from __future__ import annotations

import numpy as np

from denoc_ros.model.beam_arrays import foreshortening
from denoc_ros.model.tree import Beam, Deformation
from denoc_ros.types import Array


class Section:
    """A cross-section at a station, in the beam frame.

    Parameters
    ----------
    beam : Beam
    station : float [m], clamped to [0, length]
    geometric_stiffness : bool
        False leaves the foreshortening u_x out.

    Attributes
    ----------
    station : float [m]
    linear : (6, m), [ux uy uz rx ry rz] per amplitude (ux: none)
    shortening : (m, m) [1/m], H in ux = -d^T H d / 2
    """

    def __init__(self, beam: Beam, station: float, geometric_stiffness: bool) -> None:
        self.station = min(max(station, 0.0), beam.length)
        x = np.array([self.station])
        ny, nz, nt = beam.modes
        m = ny + nz + nt
        self.linear = np.zeros((6, m))
        self.shortening = np.zeros((m, m))
        planes = ((beam.y, 1, 5, 1.0, 0), (beam.z, 2, 4, -1.0, ny))
        for part, row, turn, sign, first in planes:
            if part is None:
                continue
            columns = slice(first, first + part.modes)
            self.linear[row, columns] = part.shapes.values(x)[0]
            self.linear[turn, columns] = sign * part.shapes.slopes(x)[0]
            if geometric_stiffness:
                self.shortening[columns, columns] = foreshortening(part.shapes, x)[0]
        self._twist(beam.torsion, x, slice(ny + nz, m))

    def _twist(self, torsion: Deformation | None, x: Array, columns: slice) -> None:
        if torsion is not None:
            self.linear[3, columns] = torsion.shapes.values(x)[0]

    def deflection(self, amplitudes: Array) -> Array:
        """Return [ux, uy, uz, rx, ry, rz] (6,) [m, rad] for amplitudes (m,), or rows of them.

        The last three are the rotation vector phi of the section, R = Exp(phi).
        """
        u: Array = amplitudes @ self.linear.T
        u[..., 0] = -0.5 * np.sum(amplitudes @ self.shortening * amplitudes, axis=-1)
        return u

    def jacobian(self, amplitudes: Array) -> Array:
        """Return the derivative (3, m), or (..., 3, m), of the displacement."""
        rows = np.empty((*amplitudes.shape[:-1], 3, amplitudes.shape[-1]))
        rows[...] = self.linear[:3]
        rows[..., 0, :] = -amplitudes @ self.shortening
        return rows

    def jacobian_rate(self, rates: Array) -> Array:
        """Return the time derivative (3, m), or (..., 3, m), of :meth:`jacobian`."""
        rows = np.zeros((*rates.shape[:-1], 3, rates.shape[-1]))
        rows[..., 0, :] = -rates @ self.shortening
        return rows

    def rate(self, amplitudes: Array, rates: Array) -> Array:
        """Return the time rates (6,) of :meth:`deflection`."""
        u: Array = rates @ self.linear.T
        u[..., 0] = -np.sum(amplitudes @ self.shortening * rates, axis=-1)
        return u
