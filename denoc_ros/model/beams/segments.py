"""Segments: a link's beam divided into equal beams, each clamped on the one before.

Each segment bends little in its own frame, and its frame takes part in the rotation of the
segments before it, so the link as a whole may bend far. The shapes of a segment must hand a
force and a moment at its tip on to its root, or more segments do not come closer to the truth:
two Craig-Bampton shapes do so exactly, clamped-free ones never do (s'' = 0 at the tip).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.linalg import eigh

from denoc_ros.model.beams.along import Along
from denoc_ros.model.beams.shapes import (
    ShapeFunctions,
    WaveShapes,
    scaled_shapes,
    shape_functions,
    wave_numbers,
)
from denoc_ros.model.tree import Beam, Deformation, Tree
from denoc_ros.types import Array

PARTS = ('y', 'z', 'torsion')  # fields of a beam, in the order of its amplitudes
ROOT = 1e-12  # of a beam's length: what arithmetic leaves of station 0


@dataclass(frozen=True)
class WholeBeam:
    """A flexible link: the bodies of its segments, root first."""

    link: str
    first: int  # index of the first segment's body in `Tree.bodies`; the others follow it
    beams: tuple[Beam, ...]  # the segments, root first

    @property
    def segment(self) -> Beam:
        """The first segment: of the numbers and modes that all have."""
        return self.beams[0]

    @property
    def segments(self) -> int:
        """Their number."""
        return self.segment.segments

    @property
    def length(self) -> float:
        """Length of the whole beam [m]."""
        return self.segment.whole_length

    @property
    def modes(self) -> int:
        """Number of amplitudes of each segment."""
        return sum(self.segment.modes)


def whole_beams(tree: Tree) -> tuple[WholeBeam, ...]:
    """Return a tree's flexible links, in coordinate order; beams without modes are none."""
    return tuple(
        WholeBeam(
            body.name,
            index,
            tuple(b.beam for b in tree.bodies[index : index + body.beam.segments] if b.beam),
        )
        for index, body in enumerate(tree.bodies)
        if body.beam is not None and any(body.beam.modes) and body.segment == 1
    )


def locate(length: float, segments: int, station: float) -> tuple[int, float]:
    """Return the segment (from 0) that holds a station, and the station on it [m].

    Parameters
    ----------
    length : float
        Of the whole beam [m].
    station : float
        On the whole beam [m]; beyond an end is that end.

    Notes
    -----
    A station where two segments meet is the root of the outboard one.
    """
    own = length / segments
    index = min(max(math.floor(station / own + segments * ROOT), 0), segments - 1)
    local = min(max(station - index * own, 0.0), own)
    return index, local if local >= ROOT * length else 0.0


def segment_shapes(modes: int, length: float) -> ShapeFunctions:
    """Return the bending shapes of a segment.

    Parameters
    ----------
    modes : int
        1: the constant curvature that a moment at the tip makes; else so many Craig-Bampton ones.
    length : float
        Of the segment [m].
    """
    if modes > 1:
        return shape_functions('craig-bampton', modes, length)
    square = np.array([[0.0, 0.0, 1.0, 0.0]])
    return WaveShapes(length, np.zeros(0), np.zeros((0, 4)), square, np.eye(1))


def segment_torsion_shapes(modes: int, length: float) -> ShapeFunctions:
    """Return the shapes of a segment's twist, by rising frequency, scaled to max |s| = 1.

    Parameters
    ----------
    modes : int
        >= 1: the linear twist that a torque at the tip makes, then sines that are 0 at both ends,
        diagonalized against stiffness and inertia.
    length : float
        Of the segment [m].
    """
    linear = np.array([[0.0, 1.0, 0.0, 0.0]])
    waves = np.zeros((modes - 1, 4))
    waves[:, 3] = 1.0
    beta = wave_numbers('pinned-pinned', modes - 1)
    raw = WaveShapes(1.0, beta, waves, linear, np.eye(modes))
    _, mixing = eigh(raw.gram(1), raw.gram(0))
    unit = scaled_shapes(WaveShapes(1.0, beta, waves, linear, np.asarray(mixing)))
    return WaveShapes(length, beta, waves, linear, unit.mixing)


def deformations(beam: Beam) -> Iterator[tuple[str, Deformation, Array]]:
    """Yield name (y, z, torsion), deformation and critical damping (modes,) of a beam.

    At a fixed root, of amplitudes scaled as the shape functions are [N s/m or N m s/rad].
    """
    for name in PARTS:
        if (part := getattr(beam, name)) is not None:
            yield name, part, critical_damping(part, *inertia_of(beam, name), beam.segments)


def inertia_of(beam: Beam, name: str) -> tuple[float, Along]:
    """Return mass, or of torsion polar inertia, per length, and its shares along the beam."""
    if name == 'torsion':
        return beam.polar_inertia, beam.polar_along
    return beam.mass_per_length, beam.mass_along


def damping_ratios(damping: Array, critical: Array) -> list[float]:
    """Return ratios of modes, rounded: 0.005 in a file is to show as such."""
    return [float(f'{ratio:.12g}') for ratio in damping / critical]


def critical_damping(part: Deformation, inertia: float, along: Along, segments: int) -> Array:
    """Return the critical damping (modes,) of a beam's amplitudes, root fixed.

    Parameters
    ----------
    inertia : float
        Mass [kg/m] or polar inertia [kg m^2/m] per length, the mean.
    along : Along
        Shares of the inertia along the beam or the segment.

    Returns
    -------
    ndarray (modes,)
        2 sqrt(k m) [N s/m or N m s/rad] of each mode. Of several segments 2 k / omega with
        omega the link's lowest frequency, tip free: a damping ratio is then that of the link's
        first mode, and damping is in proportion to stiffness, as in a viscous material.
    """
    stiffness, order = part.modal_stiffness, part.order
    if segments == 1:
        mass = inertia * np.diag(part.shapes.gram(0, along))
        return np.asarray(2.0 * np.sqrt(stiffness * mass))
    root = part.first_root
    if root is None:
        root = (float(wave_numbers('clamped-free', 1)[0]) if order == 2 else 0.5 * np.pi) ** order
    omega = root / (segments * part.shapes.length) ** order * math.sqrt(part.stiffness / inertia)
    return np.asarray(2.0 * stiffness / omega)
