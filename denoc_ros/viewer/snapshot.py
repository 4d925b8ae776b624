"""Snapshot: all data of one instant that a page or a film draws."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from denoc_ros.types import Array


@dataclass(frozen=True)
class Snapshot:
    """One instant of a robot's motion.

    Attributes
    ----------
    t : float [s]
        Since the start of the run, or of the session.
    q : (n,) array
        Coordinates in the order of `Robot.coordinate_names`, amplitudes included [rad, m].
    qd : (n,) array, optional
        Their rates; None: taken as at rest.
    torque : mapping of joint name to float, optional
        [N m] or [N]; None: not known.
    channels : mapping of str to float
        What strip charts plot, by `group/name`: `deflection [m]/predicted link_2 uy`.
    """

    t: float
    q: Array
    qd: Array | None = None
    torque: Mapping[str, float] | None = None
    channels: Mapping[str, float] = field(default_factory=dict)
