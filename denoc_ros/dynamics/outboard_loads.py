"""Strain and internal loads at stations of beams from what lies beyond them: mode acceleration.

A beam has few shapes, and inertia along it bends it by moments that these do not have. The
internal moment at a station is what all that lies outboard of it needs there. In Lagrange's terms
it is the generalized force of one more shape with a hinge at the station, that of shear one with a
step; inverse dynamics of a robot with such shapes, held at rest, gives them all at once.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace

import numpy as np

from denoc_ros.dynamics.constrained_derivatives import DifferentiableMechanism
from denoc_ros.dynamics.structure import body_amplitudes
from denoc_ros.model.segments import locate
from denoc_ros.model.shapes import HINGE, STEP, CutShapes
from denoc_ros.model.tree import Deformation, Sensor, Tree
from denoc_ros.types import Array

Cut = tuple[float, int]  # station on the body's beam [m]; HINGE or STEP
Cuts = dict[tuple[int, str], list[Cut]]  # by body and direction


class OutboardLoads:
    """Values of gauges and load cells beyond those of their beams' shapes.

    Parameters
    ----------
    robot : DifferentiableMechanism
        Its payloads, base and stiffness are followed.

    Notes
    -----
    With L the generalized forces of inertia, weight and what is carried, the amplitudes obey
    K d + C d' = -L_s, and the internal moment EI u'' at a station is -L_h, of the hinge there. So
    a value has, beyond row . d,

        row K^-1 L_s - g L_h / EI,

    g the value per curvature (for shear, + L_h of the step). What the shapes have themselves, such
    as loads at the tip of a craig-bampton beam, falls out; so do loops there, whose multipliers
    are not in L.
    """

    def __init__(self, robot: DifferentiableMechanism) -> None:
        self._sensors = [
            (place, sensor, _cut(robot.tree, sensor))
            for place, sensor in enumerate(robot.tree.sensors)
            if sensor.type != 'deflection' and robot.tree.bodies[sensor.body].beam is not None
        ]
        self._cuts: Cuts = defaultdict(list)
        for _, sensor, cut in self._sensors:
            if cut not in (known := self._cuts[sensor.body, sensor.direction]):
                known.append(cut)
        tree = _cut_tree(robot.tree, self._cuts)
        self._cut = type(robot)(tree, robot.gravity, robot.geometric_stiffness)
        names = self._cut.coordinate_names
        self._index = np.array([names.index(name) for name in robot.coordinate_names], dtype=int)
        self._payloads: dict[str, Array] = {}
        self._factors: dict[str, float] = {}
        self._diagonals = robot.arrays.diagonals
        self._weights = self._weigh(robot)

    def _weigh(self, robot: DifferentiableMechanism) -> Array:
        """Return the values per generalized force L, (sensors, n of the robot with cuts)."""
        weights = np.zeros((len(robot.tree.sensors), self._cut.n))
        names = self._cut.coordinate_names
        for place, sensor, cut in self._sensors:
            body, own = robot.tree.bodies[sensor.body], body_amplitudes(robot, sensor.body)
            deformation, before = _bending(robot.tree, sensor)
            stiffness = robot.stiffness[own]
            bends = np.flatnonzero(sensor.row)
            weights[place, self._index[own][bends]] = sensor.row[bends] / stiffness[bends]
            among = self._cuts[sensor.body, sensor.direction].index(cut)
            number = deformation.modes + among + 1
            at = names.index(f'{body.name}/{sensor.direction}{number}')
            if sensor.component == 'shear':
                weights[place, at] = 1.0
            elif sensor.component == 'moment':
                weights[place, at] = 1.0 if sensor.direction == 'y' else -1.0
            else:
                assert body.beam is not None
                # a number of the description, or live: as many times that
                live = stiffness[before] / deformation.modal_stiffness[0]
                rigidity = deformation.stiffness_at(np.array([cut[0] / body.beam.length]))[0]
                weights[place, at] = sensor.surface / (live * rigidity)
        return weights

    def values(self, robot: DifferentiableMechanism, q: Array, qd: Array, qdd: Array) -> Array:
        """Return what the values (..., sensors) have beyond the shapes' at states (..., n)."""
        cut = self._followed(robot)
        needed = cut.inverse_dynamics(self._spread(q), self._spread(qd), self._spread(qdd))
        return np.asarray(needed @ self._weights.T)

    def by_accelerations(self, robot: DifferentiableMechanism, q: Array) -> Array:
        """Return the derivatives (sensors, n) of `values` by q'' at coordinates (n,)."""
        inertia = self._followed(robot).inertia_matrix(self._spread(q))
        return np.asarray((self._weights @ inertia)[:, self._index])

    def derivatives(
        self, robot: DifferentiableMechanism, q: Array, qd: Array, qdd: Array
    ) -> tuple[Array, Array, Array]:
        """Return the derivatives (..., sensors, n) of `values` by q, q' and q''."""
        cut = self._followed(robot)
        spread = self._spread(q), self._spread(qd), self._spread(qdd)
        found = cut.inverse_dynamics_derivatives(spread[0], spread[1], spread[2])
        by_q, by_qd, by_qdd = ((self._weights @ part)[..., self._index] for part in found)
        return by_q, by_qd, by_qdd

    def _spread(self, state: Array) -> Array:
        """Return a state (..., n) of the robot with cuts, which are closed."""
        spread = np.zeros((*state.shape[:-1], self._cut.n))
        spread[..., self._index] = state
        return spread

    def _followed(self, robot: DifferentiableMechanism) -> DifferentiableMechanism:
        """Return the robot with cuts, with the loads, base and stiffness of the other now."""
        cut, loads = self._cut, robot._payloads
        if (
            self._payloads.keys() != loads.keys()
            or any(self._payloads[frame] is not load for frame, load in loads.items())
            or self._factors != robot._load_factors
        ):
            cut._take_payloads(robot)
            self._payloads, self._factors = dict(loads), dict(robot._load_factors)
        if cut.base_motion is not robot.base_motion:
            cut.move_base(robot.base_motion)
        if self._diagonals is not robot.arrays.diagonals:
            self._diagonals = robot.arrays.diagonals
            self._weights = self._weigh(robot)
        return cut


def _cut(tree: Tree, sensor: Sensor) -> Cut:
    beam = tree.bodies[sensor.body].beam
    assert beam is not None
    station = locate(beam.whole_length, beam.segments, sensor.station)[1]
    return station, STEP if sensor.component == 'shear' else HINGE


def _bending(tree: Tree, sensor: Sensor) -> tuple[Deformation, int]:
    """Return what a sensor sees of its beam, and how many amplitudes stand before."""
    beam = tree.bodies[sensor.body].beam
    assert beam is not None
    deformation = beam.y if sensor.direction == 'y' else beam.z
    assert deformation is not None
    return deformation, 0 if sensor.direction == 'y' else beam.modes[0]


def _cut_tree(tree: Tree, cuts: Cuts) -> Tree:
    """Return a robot whose beams have shapes with cuts behind theirs, and no stiffness."""
    bodies = list(tree.bodies)
    for place, body in enumerate(bodies):
        if body.beam is None:
            continue
        beam = body.beam
        for direction in ('y', 'z', 'torsion'):
            part = getattr(beam, direction)
            if part is None:
                continue
            own = tuple(cuts.get((place, direction), ()))
            shapes = CutShapes(part.shapes, own) if own else part.shapes
            none = np.zeros(part.modes + len(own))
            loose = replace(part, shapes=shapes, modal_stiffness=none, damping=none)
            beam = replace(beam, **{direction: loose})
        bodies[place] = replace(body, beam=beam)
    return replace(tree, bodies=tuple(bodies), sensors=())
