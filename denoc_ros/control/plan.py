"""A planned motion of all coordinates, with its torque."""

from __future__ import annotations

from dataclasses import dataclass

from denoc_ros.types import Array


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
        Factor by which the motion was made slower to keep the limits.
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
