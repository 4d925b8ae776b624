"""Motion of frames and predicted readings of sensors, and their derivatives by the state.

Strain and internal loads at stations of beams follow from what lies beyond them (mode
acceleration). A beam has few shapes, and inertia along it bends it by moments that these do not
have. The internal moment at a station is what all that lies outboard of it needs there. In
Lagrange's terms it is the generalized force of one more shape with a hinge at the station, that of
shear one with a
step; inverse dynamics of a robot with such shapes, held at rest, gives them all at once.
"""

from __future__ import annotations

import operator
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from denoc_ros.dynamics import structure
from denoc_ros.dynamics.base.base_motion import Base, on_base
from denoc_ros.dynamics.dynamics_derivatives import DifferentiableModel
from denoc_ros.dynamics.elastic.section import AnySection, SegmentedSection
from denoc_ros.dynamics.robot_model import with_numbers_of
from denoc_ros.dynamics.rotations import cross_matrices
from denoc_ros.dynamics.state_rows import run_rows
from denoc_ros.dynamics.structure import body_amplitudes
from denoc_ros.dynamics.validation import as_output, as_states, same_rows
from denoc_ros.errors import StateError
from denoc_ros.kernels.dynamics import frame_motion
from denoc_ros.model.arrays import ModelArrays
from denoc_ros.model.beams.segments import locate
from denoc_ros.model.beams.shapes import HINGE, STEP, CutShapes
from denoc_ros.model.tree import InertialSensor, Sensor, Tree
from denoc_ros.types import Array

Cut = tuple[float, int]  # station on the body's beam [m]; HINGE or STEP
Cuts = dict[tuple[int, str], list[Cut]]  # by body and direction
CutRobots = dict[tuple[tuple[int, str, tuple[Cut, ...]], ...], DifferentiableModel]


class OutboardLoads:
    """Values of gauges and load cells beyond those of their beams' shapes.

    Parameters
    ----------
    robot : DifferentiableModel
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

    def __init__(self, robot: SensorValues) -> None:
        self._sensors = [
            (place, sensor, _cut(robot.tree, sensor))
            for place, sensor in enumerate(robot.tree.sensors)
            if sensor.quantity != 'deflection' and robot.tree.bodies[sensor.body].beam is not None
        ]
        self._cuts: Cuts = defaultdict(list)
        for _, sensor, cut in self._sensors:
            if cut not in (known := self._cuts[sensor.body, sensor.direction]):
                known.append(cut)
        self._cut = _cut_robot(robot, self._cuts)
        names = self._cut.coordinate_names
        self._index = np.array([names.index(name) for name in robot.coordinate_names], dtype=int)
        self._payloads: dict[str, Array] = {}
        self._factors: dict[str, float] = {}
        self._diagonals = robot.arrays.diagonals
        self._weights = self._weigh(robot)
        # one state of the robot with cuts, which are closed
        self._state = np.zeros(self._cut.n), np.zeros(self._cut.n), np.zeros(self._cut.n)

    def _weigh(self, robot: DifferentiableModel) -> Array:
        """Return the values per generalized force L, (sensors, n of the robot with cuts)."""
        weights = np.zeros((len(robot.tree.sensors), self._cut.n))
        names = self._cut.coordinate_names
        for place, sensor, cut in self._sensors:
            body, own = robot.tree.bodies[sensor.body], body_amplitudes(robot, sensor.body)
            assert body.beam is not None
            deformation = body.beam.bending(sensor.direction)
            before = 0 if sensor.direction == 'y' else body.beam.modes[0]
            stiffness = robot.stiffness[own]
            bends = np.flatnonzero(sensor.row)
            weights[place, self._index[own][bends]] = sensor.row[bends] / stiffness[bends]
            among = self._cuts[sensor.body, sensor.direction].index(cut)
            number = deformation.modes + among + 1
            at = names.index(f'{body.name}/{sensor.direction}{number}')
            if sensor.quantity == 'shear':
                weights[place, at] = 1.0
            elif sensor.quantity == 'moment':
                weights[place, at] = 1.0 if sensor.direction == 'y' else -1.0
            else:
                # a number of the description, or live: as many times that
                live = stiffness[before] / deformation.modal_stiffness[0]
                rigidity = deformation.stiffness_at(np.array([cut[0] / body.beam.length]))[0]
                weights[place, at] = sensor.surface / (live * rigidity)
        return weights

    def values(self, robot: DifferentiableModel, q: Array, qd: Array, qdd: Array) -> Array:
        """Return the part of the values (..., sensors) beyond the shapes' at states (..., n)."""
        cut = self._followed(robot)
        if q.ndim > 1:
            needed = cut.inverse_dynamics(self._spread(q), self._spread(qd), self._spread(qdd))
            return np.asarray(needed @ self._weights.T)
        position, rate, acceleration = self._state
        for spread, given in ((position, q), (rate, qd), (acceleration, qdd)):
            spread[self._index] = given
        return np.asarray(self._weights @ cut.inverse_dynamics(position, rate, acceleration))

    def by_accelerations(self, robot: DifferentiableModel, q: Array) -> Array:
        """Return the derivatives (sensors, n) of `values` by q'' at coordinates (n,)."""
        inertia = self._followed(robot).inertia_matrix(self._spread(q))
        return np.asarray((self._weights @ inertia)[:, self._index])

    def derivatives(
        self, robot: DifferentiableModel, q: Array, qd: Array, qdd: Array
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

    def _followed(self, robot: DifferentiableModel) -> DifferentiableModel:
        """Return the robot with cuts, with the loads, base and stiffness of the other now."""
        cut, loads = self._cut, robot._payloads
        if (
            self._payloads.keys() != loads.keys()
            or not all(map(operator.is_, self._payloads.values(), loads.values()))
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
    return station, STEP if sensor.quantity == 'shear' else HINGE


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


def _cut_robot(robot: SensorValues, cuts: Cuts) -> DifferentiableModel:
    """Return a robot with cuts; its arrays are built once for all that differ in numbers alone."""
    tree = _cut_tree(robot.tree, cuts)
    key = tuple((*beam, tuple(own)) for beam, own in cuts.items())
    built = robot._cut_robots.get(key)
    if built is None:
        built = type(robot)(tree, robot.gravity, robot.geometric_stiffness)
        robot._cut_robots[key] = built
    return with_numbers_of(built, tree)


class SensorValues(DifferentiableModel):
    """Motion of frames, deflections of beams, sensor values, and their derivatives by the state.

    Of a frame: linear first, base axes, at its origin. The derivative of a pose by q is the
    Jacobian. Kernels compile when first asked for.
    """

    def _adopt(self, arrays: ModelArrays) -> None:
        super()._adopt(arrays)
        self._outboard: OutboardLoads | None = None  # of this robot alone: it has a workspace
        # shared by robots that differ in numbers alone
        self._cut_robots: CutRobots = self.__dict__.get('_cut_robots', {})

    def frame_motion(
        self,
        frame: str,
        q: ArrayLike,
        qd: ArrayLike,
        qdd: ArrayLike | None = None,
        out: Array | None = None,
        base: Base | None = None,
    ) -> Array:
        """Return a frame's twist and acceleration (2, 6) or (k, 2, 6).

        Parameters
        ----------
        frame : link or loop frame
        q, qd : (n,) or (k, n)
        qdd : (n,) or (k, n), optional
            Default zero.
        out : (2, 6) or (k, 2, 6), optional
        base : (twist, acceleration[, pose]), optional
            Of a base that moves, as of :meth:`Robot.inverse_dynamics`: the motion is then that in
            space, its components along the base's axes of that moment.

        Returns
        -------
        [[v, omega], [a, alpha]] : [m/s, rad/s], [m/s^2, rad/s^2]
            The acceleration is the classical one, J q'' + J' q': the second derivative of the
            position, without gravity.

        Raises
        ------
        StateError
            For an unknown frame, a wrong shape or type, or a number that is not finite.
        """
        if base is not None:
            return on_base(self, self.frame_motion, locals())
        states = (q, qd, self._zero if qdd is None else qdd)
        return self._of_motion(frame_motion.frame_motion_rows, (2, 6), frame, states, out)

    def frame_jacobian_rate(
        self, frame: str, q: ArrayLike, qd: ArrayLike, out: Array | None = None
    ) -> Array:
        """Return the time derivative (6, n) or (k, 6, n) of a frame's Jacobian along q'.

        Parameters and errors as in :meth:`frame_motion`.
        """
        kernel = frame_motion.frame_jacobian_rate_rows
        return self._of_motion(kernel, (6, self.n), frame, (q, qd), out)

    def frame_velocity_derivatives(
        self, frame: str, q: ArrayLike, qd: ArrayLike, out: Array | None = None
    ) -> tuple[Array, Array]:
        """Return the derivatives of a frame's twist by q and q', (6, n) or (k, 6, n) each.

        Parameters and errors as in :meth:`frame_motion`; out is (2, 6, n) or (k, 2, 6, n).

        Notes
        -----
        dv/dq' is the Jacobian. dv/dq is its rate but for omega, where columns T of the Jacobian
        do not commute: domega/dq_j = T_j' + T_j x omega.
        """
        kernel = frame_motion.frame_velocity_derivatives_rows
        made = self._of_motion(kernel, (2, 6, self.n), frame, (q, qd), out)
        return made[..., 0, :, :], made[..., 1, :, :]

    def frame_acceleration_derivatives(
        self,
        frame: str,
        q: ArrayLike,
        qd: ArrayLike,
        qdd: ArrayLike,
        out: Array | None = None,
    ) -> tuple[Array, Array, Array]:
        """Return the derivatives of a frame's acceleration by q, q' and q'', (6, n) each.

        Parameters and errors as in :meth:`frame_motion`; of rows (k, 6, n) each, out is
        (3, 6, n) or (k, 3, 6, n). That by q'' is the Jacobian.
        """
        kernel = frame_motion.frame_acceleration_derivatives_rows
        made = self._of_motion(kernel, (3, 6, self.n), frame, (q, qd, qdd), out)
        return made[..., 0, :, :], made[..., 1, :, :], made[..., 2, :, :]

    def section(self, link: str, station: float | None = None) -> tuple[AnySection, slice]:
        """Return the cross-section of a link's beam (default the tip) and its amplitudes."""
        key = (link, station)
        if key not in self._sections:
            self._sections[key] = structure.find_section(self, link, station)
        return self._sections[key]

    def tip_deflection(self, link: str, q: ArrayLike, station: float | None = None) -> Array:
        """Return the deflection (3,) [m] of a link's beam in the beam frame; default the tip."""
        section, amplitudes = self.section(link, station)
        q = as_states('q', q, self.n)
        return section.deflection(q[..., amplitudes])[..., :3]

    def tip_deflection_jacobian(
        self, link: str, q: ArrayLike, station: float | None = None, out: Array | None = None
    ) -> Array:
        """Return the derivative (3, n) or (k, 3, n) of :meth:`tip_deflection` by q.

        Its time derivative along q', which the rate's derivative by q is too, is that of u_x
        alone where the link is one segment: see :meth:`tip_deflection_jacobian_rate`.
        """
        section, own = self.section(link, station)
        q = as_states('q', q, self.n)
        result = as_output(out, (*q.shape[:-1], 3, self.n))
        result[...] = 0.0
        result[..., own] = section.jacobian(q[..., own])
        return result

    def tip_deflection_jacobian_rate(
        self,
        link: str,
        qd: ArrayLike,
        station: float | None = None,
        out: Array | None = None,
        q: ArrayLike | None = None,
    ) -> Array:
        """Return the time derivative (3, n) or (k, 3, n) of :meth:`tip_deflection_jacobian`.

        Of a link of one segment only foreshortening bends with the state, and its Jacobian is
        linear in q: no q is needed. A link of several segments needs it.

        Raises
        ------
        StateError
            For a wrong shape or type, or no q for a link of several segments.
        """
        section, own = self.section(link, station)
        qd = as_states('qd', qd, self.n)
        if not isinstance(section, SegmentedSection):
            rows = section.jacobian_rate(qd[..., own])
        elif q is None:
            raise StateError(f'link {link!r}: q must be given where it has segments, got none')
        else:
            rows = section.jacobian_rate(as_states('q', q, self.n)[..., own], qd[..., own])
        result = as_output(out, (*rows.shape[:-2], 3, self.n))
        result[...] = 0.0
        result[..., own] = rows
        return result

    def _of_motion(
        self,
        kernel: Any,
        shape: tuple[int, ...],
        frame: str,
        states: Sequence[ArrayLike],
        out: Array | None,
    ) -> Array:
        """Call a kernel on a frame's motion q, q' (and q''), at one state or many."""
        named = zip(('q', 'qd', 'qdd'), states, strict=False)
        arrays = [as_states(name, state, self.n) for name, state in named]
        arrays += [self._zero] * (3 - len(arrays))
        single = all(array.ndim == 1 for array in arrays)
        rows = [array[None] for array in arrays] if single else same_rows(arrays)
        count = len(rows[0])
        out = as_output(out, shape if single else (count, *shape))
        row = np.array([float(self._row(frame))])
        run_rows(self, kernel, count, *rows, row, out[None] if single else out)
        return out

    @property
    def sensor_names(self) -> tuple[str, ...]:
        """Names of the sensors' values: `gauge`, `imu/gyro_x`, ..., `imu/accel_z`."""
        return self.tree.sensor_names

    def sensor_values(
        self,
        q: ArrayLike,
        qd: ArrayLike | None = None,
        qdd: ArrayLike | None = None,
        base: Base | None = None,
    ) -> Array:
        """Return the predicted values of the sensors, in file order (each in its own unit).

        Parameters
        ----------
        q : (n,) or (k, n)
        qd, qdd : (n,) or (k, n), optional
            What IMUs and accelerometers need; default zero: the robot stands still. With qdd,
            gauges and load cells read the moment and shear of all that lies outboard of them
            (:class:`OutboardLoads`), without it the curvature of the beam's shapes.
        base : (twist, acceleration[, pose]), optional
            Of a base that moves, as of :meth:`Robot.inverse_dynamics`.

        Returns
        -------
        (values,) or (k, values)
            In the order of `sensor_names`. Of an IMU angular rate [rad/s], then specific force
            [m/s^2], the acceleration less gravity, each along the sensor's own axes on the
            deflected link; of an accelerometer the specific force. Without biases.
        """
        if base is not None:
            return on_base(self, self.sensor_values, locals())
        q = as_states('q', q, self.n)
        on_beams = self.beam_sensor_values(q, qd, qdd)
        if not self.tree.inertial_sensors:
            return on_beams
        zero = self._zero
        states = [
            q,
            zero if qd is None else as_states('qd', qd, self.n),
            zero if qdd is None else as_states('qdd', qdd, self.n),
        ]
        single = all(state.ndim == 1 for state in states)
        rows = [state[None] for state in states] if single else same_rows(states)
        motion = self._inertial_values(rows)
        values = np.empty((len(motion), len(self.sensor_names)))
        values[:, self.tree.beam_sensor_places] = on_beams
        for k, sensor in enumerate(self.tree.inertial_sensors):
            own = slice(sensor.first, sensor.first + len(sensor.parts))
            values[:, own] = motion[:, k, sensor.kind.columns]
        return values[0] if single else values

    def beam_sensor_values(
        self, q: ArrayLike, qd: ArrayLike | None = None, qdd: ArrayLike | None = None
    ) -> Array:
        """Return the predicted values of the sensors on beams alone, as `tree.sensors` has them.

        Without qdd they read the shape of a beam, so rates do not matter to them.
        """
        if qdd is not None and self.tree.sensors:
            rate = self._zero if qd is None else qd
            states = self._states(q, rate, qdd)
            return self._by_shapes(states[0]) + self._loads().values(self, *states)
        return self._by_shapes(as_states('q', q, self.n))

    def _by_shapes(self, q: Array) -> Array:
        """Return the values (..., sensors) of sensors on beams that read shapes, at (..., n)."""
        values: Array = q @ self._linear_rows.T
        for k, sensor in self._composed_sensors:
            section, own = self.section(sensor.link, sensor.station)
            moved = section.deflection(q[..., own])
            values[..., k] = moved[..., 1 if sensor.direction == 'y' else 2]
        return values

    def beyond_shapes(self, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike) -> Array:
        """Return the part of beam sensors' values (..., sensors) beyond their shapes'."""
        return self._loads().values(self, *self._states(q, qd, qdd))

    def beyond_shapes_by_accelerations(self, q: ArrayLike) -> Array:
        """Return the derivatives (sensors, n) of `beyond_shapes` by q'' at q (n,)."""
        return self._loads().by_accelerations(self, as_states('q', q, self.n))

    def _loads(self) -> OutboardLoads:
        if self._outboard is None:
            self._outboard = OutboardLoads(self)
        return self._outboard

    def _states(self, *given: ArrayLike) -> list[Array]:
        """Return q, q', q'', all (n,) or all rows."""
        states = [as_states(a, x, self.n) for a, x in zip(('q', 'qd', 'qdd'), given, strict=True)]
        return states if all(state.ndim == 1 for state in states) else same_rows(states)

    def sensor_derivatives(
        self,
        q: ArrayLike,
        qd: ArrayLike | None = None,
        qdd: ArrayLike | None = None,
        by_shapes: bool = False,
    ) -> tuple[Array, Array, Array]:
        """Return the derivatives of the sensors' values by q, q' and q'', (values, n) each.

        Of rows (k, values, n). Without qdd, or `by_shapes`, sensors on beams read their shape:
        those by q' and q'' are zero. Of inertial sensors qd and qdd are zero by default.
        """
        zero, moments = self._zero, qdd is not None and not by_shapes
        states = self._states(q, zero if qd is None else qd, zero if qdd is None else qdd)
        shape = (*states[0].shape[:-1], len(self.sensor_names), self.n)
        by_q, by_qd, by_qdd = (np.zeros(shape) for _ in range(3))
        places = self.tree.beam_sensor_places
        by_q[..., places, :] = self.beam_sensor_rows(states[0])
        if moments and places:
            found = self._loads().derivatives(self, *states)
            for whole, beyond in zip((by_q, by_qd, by_qdd), found, strict=True):
                whole[..., places, :] += beyond
        for sensor in self.tree.inertial_sensors:
            part = slice(sensor.first, sensor.first + len(sensor.parts))
            found = self._inertial_derivatives(sensor, states)
            by_q[..., part, :], by_qd[..., part, :], by_qdd[..., part, :] = found
        return by_q, by_qd, by_qdd

    def beam_sensor_rows(self, q: ArrayLike) -> Array:
        """Return the derivative (sensors, n) or (k, sensors, n) of `beam_sensor_values` by q."""
        q = as_states('q', q, self.n)
        linear = self._linear_rows
        rows: Array = np.broadcast_to(linear, (*q.shape[:-1], *linear.shape)).copy()
        for k, sensor in self._composed_sensors:
            section, own = self.section(sensor.link, sensor.station)
            axis = 1 if sensor.direction == 'y' else 2
            rows[..., k, own] = section.jacobian(q[..., own])[..., axis, :]
        return rows

    @cached_property
    def _linear_rows(self) -> Array:
        return structure.sensor_rows(self)

    @cached_property
    def _composed_sensors(self) -> list[tuple[int, Sensor]]:
        return structure.composed_sensors(self)

    @cached_property
    def _inertial_frames(self) -> Array:
        """How many inertial sensors there are, then the rows of the model on which they are."""
        frames = [self._row(sensor.frame) for sensor in self.tree.inertial_sensors]
        return np.array([len(frames), *frames], dtype=np.float64)

    def _inertial_values(self, states: list[Array]) -> Array:
        """Return angular rate and specific force (k, sensors, 6) of all inertial sensors."""
        count, frames = len(states[0]), self._inertial_frames
        motion = np.empty((count, len(frames) - 1, 6))
        status = run_rows(self, frame_motion.inertial_values_rows, count, *states, frames, motion)
        q, qd, qdd = states
        self.raise_for_status(status, q=q, qd=qd, qdd=qdd)
        return motion

    def _inertial_derivatives(
        self, sensor: InertialSensor, states: list[Array]
    ) -> tuple[Array, Array, Array]:
        """Return the derivatives (..., parts, n) of its values by q, q' and q''.

        Notes
        -----
        With the sensor's axes R and the columns T of its angular Jacobian,
        d(R^T x)/dq_j = R^T (dx/dq_j - T_j x x).
        """
        q, qd, qdd = states
        axes = self.frame_pose(sensor.frame, q)[..., :3, :3]
        jacobian = self.frame_jacobian(sensor.frame, q)
        motion = self.frame_motion(sensor.frame, q, qd, qdd)
        rate, force = motion[..., 0, 3:], motion[..., 1, :3] - self.gravity_in_base
        velocity = self.frame_velocity_derivatives(sensor.frame, q, qd)
        acceleration = self.frame_acceleration_derivatives(sensor.frame, q, qd, qdd)
        turned = [np.matmul(cross_matrices(x), jacobian[..., 3:, :]) for x in (rate, force)]
        zero = np.zeros_like(turned[0])
        found = (
            (velocity[0][..., 3:, :] + turned[0], acceleration[0][..., :3, :] + turned[1]),
            (velocity[1][..., 3:, :], acceleration[1][..., :3, :]),
            (zero, acceleration[2][..., :3, :]),
        )
        back, own = np.swapaxes(axes, -1, -2), sensor.kind.columns
        by_q, by_qd, by_qdd = (
            np.concatenate([np.matmul(back, part) for part in parts], axis=-2)[..., own, :]
            for parts in found
        )
        return by_q, by_qd, by_qdd
