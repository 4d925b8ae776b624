"""Camera of a film: directions of view, and the automatic choice between them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from denoc_ros.types import Array

FLAT = 0.2  # of the second widest extent: what is narrower than that is seen from its flat side
AUTO = 'auto'
# What is to the right and what is up, base axes.
VIEWS = {
    'side': ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0)),
    'top': ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0)),
    'front': ((0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
    'iso': ((0.8, 0.6, 0.0), (-0.3, 0.4, 0.75**0.5)),
}
LOOKS_ALONG = ('front', 'side', 'top')  # x, y, z


@dataclass(frozen=True)
class Camera:
    """A parallel projection.

    Attributes
    ----------
    view : str
        One of `VIEWS`.
    axes : (3, 3) array
        Rows: right, up, and towards the eye; base axes, a proper rotation.
    """

    view: str
    axes: Array

    @property
    def flat(self) -> bool:
        """Whether it looks along a base axis, so that the picture has true coordinates."""
        return self.view != 'iso'

    def project(self, points: Array) -> Array:
        """Return (..., 3): right and up in the picture, and depth towards the eye [m]."""
        return np.asarray(points @ self.axes.T)


def camera(view: str, instants: Array) -> Camera:
    """Return the camera of a view.

    Parameters
    ----------
    view : {'auto', 'side', 'top', 'front', 'iso'}
        auto: onto the plane of a motion that stays in one, or of a robot that does; else iso.
    instants : (k, v, 3) array
        Where points of the robot are at some instants [m, base frame].
    """
    chosen = best_view(instants) if view == AUTO else view
    right, up = (np.array(axis) for axis in VIEWS[chosen])
    return Camera(chosen, np.array([right, up, np.cross(right, up)]))


def best_view(instants: Array) -> str:
    """Return the view that shows the motion of points at some instants, (k, v, 3)."""
    moved = (instants - instants.mean(axis=0)).reshape(-1, 3)
    for points in (moved, instants.reshape(-1, 3)):
        extent = np.ptp(points, axis=0)
        narrow, second, _ = np.argsort(extent)
        if extent[narrow] < FLAT * extent[second]:
            return LOOKS_ALONG[narrow]
    return 'iso'
