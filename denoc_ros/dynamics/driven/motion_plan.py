"""A planned motion of all coordinates, with its torque."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from denoc_ros.types import Array

BINDS = 0.995  # of a limit: what counts as reached


@dataclass(frozen=True)
class LimitUse:
    """How much of its limits a plan uses.

    Attributes
    ----------
    names : tuple of str
        Of the limits that there are: what and whose.
    shares : (k, limits) array
        At the plan's times; 1 is a limit.
    gains : mapping of name to float
        By which share of the duration a limit that is 1 % larger would make the shortest motion
        shorter, to first order; of plans in minimum time.
    spread : mapping of name to float
        Largest share of each limit over robots that are a little other; of plans with
        `uncertainty`.
    settled : bool
        Whether a plan in minimum time was found to the end; False: the best so far.
    """

    names: tuple[str, ...]
    shares: Array
    gains: Mapping[str, float]
    settled: bool = True
    spread: Mapping[str, float] = field(default_factory=dict)

    @property
    def largest(self) -> dict[str, float]:
        """Largest share of each limit."""
        return dict(zip(self.names, self.shares.max(axis=0, initial=0.0).tolist(), strict=True))

    def binding(self) -> list[str]:
        """Return which limit is reached at each time, '' where none is."""
        if not self.names:
            return [''] * len(self.shares)
        most = self.shares.argmax(axis=1)
        reached = self.shares.max(axis=1) >= BINDS * min(1.0, float(self.shares.max(initial=0.0)))
        return [
            self.names[k] if at else ''
            for k, at in zip(most.tolist(), np.asarray(reached).tolist(), strict=True)
        ]


@dataclass(frozen=True)
class Plan:
    """A plan: the motion of all coordinates, with torque and tip error.

    Attributes
    ----------
    method : str
        How it was planned: ``tip``, ``zv``, ``zvd``, ``ei`` or ``rest_to_rest``.
    t : (k,) array
        Times [s], in the time of the motion that was asked for: a plan that must move before that
        begins at ``-preaction``.
    q, qd, qdd : (k, n) arrays
        All coordinates of the robot with their rates and accelerations.
    torque : (k, joints) array
        Of the robot's driven joints, in the order of ``joint_names`` [N m, N].
    joint_names, coordinate_names : tuple of str
        Of the columns of `torque`, and of `q`.
    tip_error : (k,) array
        Distance of the tip from where it was asked to be [m]; of several, the largest.
    tip_turn : (k,) array
        Angle between the tip and how it was asked to be turned [rad]; of several, the largest.
    preaction, postaction : float
        How long the joints move before and after the motion that was asked for [s].
    delay : float
        How much later than asked for the motion arrives [s].
    stretch : float
        Factor by which the motion was made slower to keep the limits; of one in minimum time, its
        duration over that of the motion that was asked for.
    equation_error : float
        Root mean square of the forces that no actuator gives and the plan needs between its nodes,
        over their stiffness [m, rad]: what the grid leaves. Of a base that floats, how far it
        would drift by the momentum that is left.
    base_wrench : (k, 6) array or None
        Of a floating base that thrusters hold (``base='free_flying'``): force and torque on the
        base link about its origin, in the root frame's axes [N, N m]; else None.
    """

    method: str
    t: Array
    q: Array
    qd: Array
    qdd: Array
    torque: Array
    joint_names: tuple[str, ...]
    coordinate_names: tuple[str, ...]
    tip_error: Array
    tip_turn: Array
    preaction: float = 0.0
    postaction: float = 0.0
    delay: float = 0.0
    stretch: float = 1.0
    equation_error: float = 0.0
    base_wrench: Array | None = None
    limits: LimitUse | None = None
    passed: Array | None = None
