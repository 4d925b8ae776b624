"""Links with component modes whose columns are a beam's own: the robot must be the beam's."""

from __future__ import annotations

import numpy as np

from denoc_ros.model.beams.beam_arrays import beam_points, foreshortening
from denoc_ros.model.beams.link_file import LinkFrame, ReducedLink, StrainPoint
from denoc_ros.model.tree import Beam
from denoc_ros.types import Array

TURN = np.array([[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]])  # any rotation


def beam_as_link(beam: Beam, turn: Array | None = None) -> ReducedLink:
    """Return a bending beam's modes as columns of three components, in the beam frame or turned.

    turn: (3, 3) beam axes seen from the link frame.
    """
    turn = np.eye(3) if turn is None else turn
    parts = [(part, axis) for part, axis in ((beam.y, 1), (beam.z, 2)) if part is not None]
    ny, nz, _ = beam.modes
    m, pairs = ny + nz, []
    rows = beam_points(beam, True)
    ends = np.array([beam.length])
    phi, theta = np.zeros((3, m)), np.zeros((3, m))
    points = np.zeros((len(rows), 4 + 3 * m))
    points[:, :2] = rows[:, :2]
    curves, ends_of, curvature = [], [], np.zeros((2, m))
    first, h = 0, 2 + m
    for part, axis in parts:
        k = part.modes
        for j in range(k):
            points[:, 4 + 3 * (first + j) + axis] = rows[:, 2 + first + j]
        columns = slice(first, first + k)
        phi[axis, columns] = part.shapes.values(ends)[0]
        sign = 1.0 if axis == 1 else -1.0
        theta[3 - axis, columns] = sign * part.shapes.slopes(ends)[0]
        curvature[axis - 1, columns] = part.shapes.curvatures(np.zeros(1))[0]
        end = foreshortening(part.shapes, ends)[0]
        for i in range(k):
            for j in range(i, k):
                pairs.append((first + i, first + j))
                curves.append(-rows[:, h + k * i + j])
                ends_of.append(-end[i, j])
        first, h = first + k, h + k * k
    g = len(pairs)
    second, quadratic = np.zeros((len(rows), 3 * g)), np.zeros((3, g))
    second[:, ::3], quadratic[0] = np.array(curves).T, ends_of
    points[:, 1:4] = points[:, 1:4] @ turn.T
    for table in (points[:, 4:], second):
        table[:] = (table.reshape(len(rows), -1, 3) @ turn.T).reshape(len(rows), -1)
    mass = points[:, 0] @ points[:, 0]
    spread = points[:, 1:4].T @ points[:, 1:4]
    stiffness = [part.modal_stiffness for part, _ in parts]
    tip = LinkFrame(
        turn @ [beam.length, 0.0, 0.0], turn, turn @ phi, turn @ theta, turn @ quadratic
    )
    return ReducedLink(
        mass=float(mass),
        com=points[:, 0] @ points[:, 1:4] / mass,
        inertia=np.trace(spread) * np.eye(3) - spread,
        points=np.concatenate([points, second], axis=1),
        stiffness=np.concatenate(stiffness),
        pairs=np.array(pairs),
        frames={'tip': tip},
        damping=np.concatenate([part.damping for part, _ in parts]),
        strain={'root': StrainPoint(np.zeros(3), turn[:, 0], -0.02 * curvature[0])},
        source='a beam',
    )
