"""Deflection of cross-sections of beams and frames of links, by their links' amplitudes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from denoc_ros.dynamics.rotations import (
    cross_matrices,
    left_jacobian_rates,
    left_jacobians,
    rotation_vectors,
    rotations,
)
from denoc_ros.model.beams.beam_arrays import foreshortening, second_order
from denoc_ros.model.beams.link_file import ReducedLink
from denoc_ros.model.beams.segments import locate
from denoc_ros.model.tree import Beam, Deformation
from denoc_ros.types import Array


class Section:
    """A cross-section at a station, in the beam frame.

    Parameters
    ----------
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


class _Placed(NamedTuple):
    """Segments as they stand in the beam frame; s of them, the section's own the last."""

    roots: Array  # (..., s, 3, 3) axes of each segment's frame
    ends: Array  # (..., s, 3) [m] where each ends: its tip, or the section
    local: Array  # (..., s, 6) deflection of each end in its own frame
    turn: Array  # (..., 3, 3) of the section


class SegmentedSection:
    """A cross-section at a station of the whole beam, in the frame of the beam's root.

    Parameters
    ----------
    beams : sequence of Beam
        The segments, root first.
    station : float [m], clamped to [0, whole length]
    geometric_stiffness : bool
        False leaves the foreshortening of each segment out.

    Attributes
    ----------
    station : float [m]
    linear : (6, m), [ux uy uz rx ry rz] per amplitude of the whole link where it bends little

    Notes
    -----
    The section of the one segment carries the next: positions and rotations are composed, so
    deflections may be as large as they like; rotation vectors are at most pi long.
    """

    def __init__(self, beams: Sequence[Beam], station: float, geometric_stiffness: bool) -> None:
        beam = beams[0]
        self.station = min(max(station, 0.0), beam.whole_length)
        self._last, local = locate(beam.whole_length, beam.segments, self.station)
        self._modes, self._segments = sum(beam.modes), beam.segments
        each = [Section(part, part.length, geometric_stiffness) for part in beams[: self._last]]
        each.append(Section(beams[self._last], local, geometric_stiffness))
        self._linear = np.array([section.linear for section in each])  # (s, 6, m)
        self._shortening = np.array([section.shortening for section in each])  # (s, m, m)
        self._stations = np.array([section.station for section in each])  # (s,)
        self.linear = self.twists(np.zeros(beam.segments * self._modes))

    def deflection(self, amplitudes: Array) -> Array:
        """Return [ux, uy, uz, rx, ry, rz] (6,) [m, rad] for amplitudes (m,), or rows of them.

        The last three are the rotation vector of the section.
        """
        at = self._place(amplitudes)
        moved = at.ends[..., -1, :] - [self.station, 0.0, 0.0]
        return np.concatenate([moved, rotation_vectors(at.turn)], axis=-1)

    def rate(self, amplitudes: Array, rates: Array) -> Array:
        """Return the time rates (6,) of :meth:`deflection`."""
        at = self._place(amplitudes)
        vector = rotation_vectors(at.turn)
        d, dd = self._parts(amplitudes), self._parts(rates)
        slide, turned, arms = self._columns(at, d)
        turning = np.matmul(turned, dd[..., None])[..., 0]
        linear = np.matmul(slide, dd[..., None])[..., 0] + np.cross(turning, arms)
        angular = np.linalg.solve(left_jacobians(vector), turning.sum(axis=-2)[..., None])[..., 0]
        return np.concatenate([linear.sum(axis=-2), angular], axis=-1)

    @property
    def ends(self) -> tuple[Array, Array, Array]:
        """Of each segment's end: `linear` (s, 6, m), `shortening` (s, m, m), length (s,) [m]."""
        return self._linear, self._shortening, self._stations

    def jacobian(self, amplitudes: Array) -> Array:
        """Return the derivative (3, m), or (..., 3, m), of the displacement."""
        moved: Array = self.twists(amplitudes)[..., :3, :]
        return moved

    def twists(self, amplitudes: Array) -> Array:
        """Return the section's twist per rate of each amplitude, (6, m), linear first."""
        at = self._place(amplitudes)
        moved, turned, arms = self._columns(at, self._parts(amplitudes))
        return self._gather(moved + _crossed(turned, arms), turned)

    def jacobian_rate(self, amplitudes: Array, rates: Array) -> Array:
        """Return the time derivative (3, m), or (..., 3, m), of :meth:`jacobian`."""
        amplitudes, rates = np.broadcast_arrays(amplitudes, rates)
        at, d, dd = self._place(amplitudes), self._parts(amplitudes), self._parts(rates)
        moved, turned, arms = self._columns(at, d)
        own = (turned * dd[..., None, :]).sum(axis=-1)  # (..., s, 3) turning of each on its root
        root = np.cumsum(own, axis=-2) - own  # of each segment's frame
        step = np.matmul(moved, dd[..., None])[..., 0]
        step += np.cross(root, self._span(at))
        ends = np.cumsum(step, axis=-2)
        spin = cross_matrices(root)
        phi = at.local[..., 3:]
        phi_rate = np.matmul(self._linear[:, 3:], dd[..., None])[..., 0]
        bent = np.matmul(left_jacobian_rates(phi, phi_rate), self._linear[:, 3:])
        turned_rate = np.matmul(spin, turned) + np.matmul(at.roots, bent)
        drawn = np.zeros_like(moved)
        drawn[..., 0, :] = -np.matmul(dd[..., None, :], self._shortening)[..., 0, :]
        moved_rate = np.matmul(spin, moved) + np.matmul(at.roots, drawn)
        rate = moved_rate + _crossed(turned_rate, arms)
        rate += _crossed(turned, ends[..., -1:, :] - ends)
        return self._gather(rate)

    def _parts(self, amplitudes: Array) -> Array:
        """Return the amplitudes (..., s, m) of the segments up to the section."""
        parts = amplitudes.reshape(*amplitudes.shape[:-1], self._segments, self._modes)
        inboard: Array = parts[..., : self._last + 1, :]
        return inboard

    def _place(self, amplitudes: Array) -> _Placed:
        d = self._parts(amplitudes)
        local = np.matmul(self._linear, d[..., None])[..., 0]
        drawn = np.matmul(self._shortening, d[..., None])[..., 0]
        local[..., 0] = -0.5 * np.sum(drawn * d, axis=-1)
        turns = rotations(local[..., 3:])
        points = local[..., :3].copy()
        points[..., 0] += self._stations
        roots, ends = np.empty(turns.shape), np.empty(points.shape)
        end, turn = np.zeros(3), np.eye(3)
        for k in range(self._last + 1):
            roots[..., k, :, :] = turn
            end = end + np.matmul(turn, points[..., k, :, None])[..., 0]
            turn = np.matmul(turn, turns[..., k, :, :])
            ends[..., k, :] = end
        return _Placed(roots, ends, local, turn)

    def _columns(self, at: _Placed, d: Array) -> tuple[Array, Array, Array]:
        """Return how each amplitude moves and turns its segment's end, and the section's arms."""
        slide = np.broadcast_to(self._linear[:, :3], (*d.shape[:-1], 3, self._modes)).copy()
        slide[..., 0, :] = -np.matmul(d[..., None, :], self._shortening)[..., 0, :]
        bent = np.matmul(left_jacobians(at.local[..., 3:]), self._linear[:, 3:])
        arms = at.ends[..., -1:, :] - at.ends
        return np.matmul(at.roots, slide), np.matmul(at.roots, bent), arms

    def _span(self, at: _Placed) -> Array:
        """Return the vector (..., s, 3) from each segment's root to its end."""
        span: Array = at.ends.copy()
        span[..., 1:, :] -= at.ends[..., :-1, :]
        return span

    def _gather(self, *columns: Array) -> Array:
        """Return the columns (..., s, 3, m) of all segments side by side, 0 beyond the section."""
        lead, count = columns[0].shape[:-3], self._last + 1
        result = np.zeros((*lead, 3 * len(columns), self._segments * self._modes))
        for index, each in enumerate(columns):
            flat = np.moveaxis(each, -3, -2).reshape(*lead, 3, count * self._modes)
            result[..., 3 * index : 3 * index + 3, : count * self._modes] = flat
        return result


def _crossed(turned: Array, arms: Array) -> Array:
    """Return turned x arm, column by column: (..., s, 3, m) and (..., s, 3)."""
    return np.asarray(np.matmul(-cross_matrices(arms), turned))


class ComponentSection:
    """A frame of a link, in the link frame.

    Parameters
    ----------
    name : str
        Of the frame.
    geometric_stiffness : bool
        False leaves the second-order displacement out.

    Attributes
    ----------
    linear : (6, m), [ux uy uz rx ry rz] per amplitude
    gamma : (3, m, m), second derivatives of the displacement
    """

    def __init__(self, link: ReducedLink, name: str, geometric_stiffness: bool) -> None:
        frame = link.frames[name]
        self.linear = np.concatenate([frame.phi, frame.theta])
        self.gamma = np.moveaxis(second_order(link, frame.quadratic.T.ravel()), -1, 0)
        if not geometric_stiffness:
            self.gamma = np.zeros_like(self.gamma)

    def deflection(self, amplitudes: Array) -> Array:
        """Return [ux, uy, uz, rx, ry, rz] (6,) [m, rad] for amplitudes (m,), or rows of them."""
        u: Array = amplitudes @ self.linear.T
        u[..., :3] += 0.5 * np.einsum('cij,...i,...j->...c', self.gamma, amplitudes, amplitudes)
        return u

    def jacobian(self, amplitudes: Array) -> Array:
        """Return the derivative (3, m), or (..., 3, m), of the displacement."""
        return np.asarray(self.linear[:3] + self.jacobian_rate(amplitudes))

    def jacobian_rate(self, rates: Array) -> Array:
        """Return the time derivative (3, m), or (..., 3, m), of :meth:`jacobian`."""
        return np.asarray(np.einsum('cij,...j->...ci', self.gamma, rates))

    def rate(self, amplitudes: Array, rates: Array) -> Array:
        """Return the time rates (6,) of :meth:`deflection`."""
        u: Array = rates @ self.linear.T
        u[..., :3] += np.einsum('cij,...i,...j->...c', self.gamma, amplitudes, rates)
        return u


AnySection = Section | SegmentedSection | ComponentSection
