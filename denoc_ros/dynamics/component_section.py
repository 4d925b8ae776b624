"""Deflection of a frame of a link with component modes, as a function of its amplitudes."""

from __future__ import annotations

import numpy as np

from denoc_ros.dynamics.section import Section
from denoc_ros.dynamics.segmented_section import SegmentedSection
from denoc_ros.model.beam_arrays import second_order
from denoc_ros.model.link_file import ReducedLink
from denoc_ros.types import Array


class ComponentSection:
    """A frame of a link, in the link frame.

    Parameters
    ----------
    link : ReducedLink
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
