"""A robot that MuJoCo simulates: each beam a chain of rods on sprung hinges."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from denoc_ros.dynamics.base.floating_base import ATTITUDE
from denoc_ros.dynamics.elastic.state_bounds import StateBounds
from denoc_ros.dynamics.robot import Robot
from denoc_ros.dynamics.rotations import left_jacobians, rotation_vectors, rotations
from denoc_ros.errors import ConfigError, StateError
from denoc_ros.export.mjcf import INERTIAL_TAGS, SEGMENTS, Mjcf, mjcf
from denoc_ros.export.mujoco_chain import MujocoChain, mujoco_module
from denoc_ros.model.beams.segments import whole_beams
from denoc_ros.model.reading.poses import pose_of
from denoc_ros.model.reading.source import parse_xml, read_source
from denoc_ros.model.tree import Tree
from denoc_ros.simulation.simulated_robot import Drives, SimulatedRobot
from denoc_ros.types import Array

DIFFERENCE = 1e-6  # rad or m
STABLE = 2.0  # Runge-Kutta steps of order 4 are stable up to 2.6 over the fastest rate
HEAVY = 1e9  # of the largest inertia: armature of a joint whose motion is given
SCENE = 'scene/'  # before the names of what a scene adds


class MujocoSettings(NamedTuple):
    """How MuJoCo simulates a robot."""

    segments: int = SEGMENTS  # hinges per beam and deformation
    scene: str = ''  # path of an MJCF file of objects in the world; '': none
    static: bool = True  # whether it starts in equilibrium, its joints held


class MujocoRobot:
    """A robot simulated by MuJoCo; :class:`SimulatedRobot` has the public interface.

    Amplitudes among `q` and `qd` are projections of the hinge angles on the model's shapes.

    Parameters
    ----------
    robot : Robot
        The model, whose names, coordinates and gravity are the plant's.
    tree : Tree
        Its description, payloads included.
    step : float
        [s]; MuJoCo takes as many steps of its own as its chains need.
    start : (n,) array
        Where it starts, loops closed.

    Raises
    ------
    ConfigError
        MuJoCo is not installed, or does not take the scene.
    ModelError
        What MJCF cannot hold; a scene that cannot be read.
    SolverError
        There is no equilibrium near the start.
    """

    def __init__(
        self,
        robot: Robot,
        tree: Tree,
        step: float,
        start: Array,
        drives: Drives,
        settings: MujocoSettings,
    ) -> None:
        self.mujoco = mujoco_module()
        self.robot, self.step = robot, step
        self.bounds: StateBounds | None = None  # A chain of hinges bends as far as it likes.
        made = mjcf(tree, robot.gravity, settings.segments)
        self.model = self._compiled(made, settings.scene)
        self.model.opt.disableflags |= self.mujoco.mjtDisableBit.mjDSBL_AUTORESET
        self.data = self.mujoco.MjData(self.model)
        self._find_coordinates(made)
        self._find_base(tree)
        self._given = np.array([self._degree(name) for name in drives.given], dtype=np.intp)
        self._given_places = np.array([self._place_of(n) for n in drives.given], dtype=np.intp)
        self._armature = self.model.dof_armature.copy()
        self._set_feedback(drives)
        self.q, self.qd, self.qdd = np.zeros((3, robot.n))
        self._values = np.zeros(len(tree.sensors))
        self._beams = [(beam.link, beam.length) for beam in whole_beams(tree)]
        self._resting = self._at_start(made, start, drives, settings.static)
        self.place()
        self._steps = max(1, math.ceil(step * self._fastest() / STABLE))
        self.model.opt.timestep = step / self._steps
        self._heavy = HEAVY * float(self.data.M.max())
        self.start = self.q.copy()

    # ---- making

    def _compiled(self, made: Mjcf, scene: str) -> Any:
        """Return the model, with the objects of a scene."""
        robot = self.mujoco.MjSpec.from_string(made.text)
        if not scene:
            return robot.compile()
        # it may have no DOCTYPE or entities
        parse_xml(*read_source(Path(scene)), root='mujoco')
        try:
            objects = self.mujoco.MjSpec.from_file(scene)
            robot.attach(objects, prefix=SCENE, frame=robot.worldbody.add_frame())
            return robot.compile()
        except ValueError as error:
            got = ' '.join(str(error).split())
            raise ConfigError(
                scene, [f'the scene must be a model for MuJoCo, got: {got}']
            ) from error

    def _degree(self, joint: str) -> int:
        return int(self.model.jnt_dofadr[self.model.joint(joint).id])

    def _place_of(self, joint: str) -> int:
        return int(self.model.jnt_qposadr[self.model.joint(joint).id])

    def _find_coordinates(self, made: Mjcf) -> None:
        """Find joints and springs among MuJoCo's, and the hinges of each amplitude."""
        names = list(self.robot.coordinate_names)
        hinges = [hinge for part in made.deformations for hinge in part.hinges]
        mine = {self.model.joint(k).name for k in range(self.model.njnt)} - set(hinges)
        self._joints = np.array([k for k, n in enumerate(names) if n in mine], dtype=np.intp)
        self._places, self._degrees = (
            np.array([of(names[k]) for k in self._joints], dtype=np.intp)
            for of in (self._place_of, self._degree)
        )
        self._hinge_places, self._hinge_degrees = (
            np.array([of(name) for name in hinges], dtype=np.intp)
            for of in (self._place_of, self._degree)
        )
        count = sum(len(part.amplitudes) for part in made.deformations)
        self._flexible = np.zeros(count, dtype=np.intp)
        self._projection, self._bending = np.zeros((2, count, len(hinges)))
        row = column = 0
        for part in made.deformations:
            rows = slice(row, row + len(part.amplitudes))
            columns = slice(column, column + len(part.hinges))
            self._flexible[rows] = [names.index(name) for name in part.coordinates]
            self._projection[rows, columns] = part.amplitudes
            self._bending[rows, columns] = part.angles
            row, column = rows.stop, columns.stop

    def _find_base(self, tree: Tree) -> None:
        """Find the pose of a floating base's joint frame, and its body frame behind the link's."""
        self._floating: tuple[Array, Array] | None = None
        for body in tree.bodies:
            if body.floating:
                self._floating = (body.attachment.placement, body.frame)
                self._base_place, self._base_degree = (
                    of(body.floating) for of in (self._place_of, self._degree)
                )

    def _set_feedback(self, drives: Drives) -> None:
        """Let each drive's motor be a spring and damper to zero, when it is switched on."""
        names = dict(zip(self.robot.joint_indices, self.robot.joint_names, strict=True))
        motors = [self.model.actuator(names[k]).id for k in drives.coordinates]
        self.model.actuator_ctrllimited[:] = False  # whoever drives it says what its limits are
        self._motors = np.array(motors, dtype=np.intp)
        self._driven, self._kp, self._kd = drives.coordinates, drives.kp, drives.kd
        self.model.actuator_biastype[motors] = self.mujoco.mjtBias.mjBIAS_AFFINE

    def _fastest(self) -> float:
        """Return the largest eigenvalue's size [1/s] of the robot at rest, feedback included."""
        data, model, count = self.data, self.model, self.model.nv
        matrices = np.zeros((2, count, count))
        for k, unit in enumerate(np.eye(count)):
            for matrix, size in zip(matrices, (0.0, DIFFERENCE), strict=True):
                data.qpos[:], data.qvel[:] = self._resting, unit if size == 0.0 else 0.0
                self.mujoco.mj_integratePos(model, data.qpos, unit, size)
                self.mujoco.mj_fwdPosition(model, data)
                self.mujoco.mj_fwdVelocity(model, data)
                matrix[:, k] = -data.qfrc_passive / (size or 1.0)
        data.qpos[:], data.qvel[:] = self._resting, 0.0
        self.mujoco.mj_forward(model, data)
        rest, mass = data.qfrc_passive[:, None], np.zeros((count, count))
        for row, unit in zip(mass, np.eye(count), strict=True):
            self.mujoco.mj_mulM(model, data, row, unit)
        damping, stiffness = matrices[0] + rest, matrices[1] + rest / DIFFERENCE
        driven = [self._degrees[list(self._joints).index(k)] for k in self._driven]
        damping[driven, driven] += self._kd
        stiffness[driven, driven] += self._kp
        zero, unit = np.zeros((count, count)), np.eye(count)
        pulled = -np.linalg.solve(mass, np.hstack([stiffness, damping]))
        system = np.block([[zero, unit], [pulled]])
        return float(np.abs(np.linalg.eigvals(system)).max())

    def _feed_back(self, kp: Array | float, kd: Array | float) -> None:
        self.model.actuator_biasprm[self._motors, 1] = -np.asarray(kp)
        self.model.actuator_biasprm[self._motors, 2] = -np.asarray(kd)

    def _at_start(self, made: Mjcf, start: Array, drives: Drives, static: bool) -> Array:
        """Return MuJoCo's coordinates where the robot starts."""
        places = self.data.qpos.copy()
        places[self._places] = start[self._joints]
        places[self._hinge_places] = self._bending.T @ start[self._flexible]
        if self._floating is not None:
            before, behind = self._floating
            at = self.robot.base_indices
            moved = pose_of(start[at[:3]], rotations(start[at[ATTITUDE]]))
            pose = before @ moved @ behind
            places[self._base_place : self._base_place + 3] = pose[:3, 3]
            turned = places[self._base_place + 3 : self._base_place + 7]
            self.mujoco.mju_mat2Quat(turned, pose[:3, :3].ravel())
        elif static:
            names = list(self.robot.joint_names)
            held = {n: start[self.robot.joint_indices[names.index(n)]] for n in drives.given}
            guess = {
                self.model.joint(k).name: float(places[self.model.jnt_qposadr[k]])
                for k in range(self.model.njnt)
                if not self.model.joint(k).name.startswith(SCENE)
            }
            chain = MujocoChain(made.text, held, guess)
            chain.settle()
            for name in guess:
                places[self._place_of(name)] = chain.joint(name)
        return np.asarray(places)

    # ---- moving

    def place(self) -> None:
        """Put it, and the objects of its scene, to rest at the start."""
        self.mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:] = self._resting
        self._read()
        self.qdd[:] = 0.0

    def follow(self, before: SimulatedRobot) -> None:
        """Take over the state of the same robot with other numbers."""
        assert isinstance(before, MujocoRobot)
        for name in ('qpos', 'qvel', 'qacc_warmstart'):
            getattr(self.data, name)[:] = getattr(before.data, name)
        self.data.time = before.data.time
        self._read()
        self.qdd[:] = before.qdd

    def hold(self) -> None:
        """Take a step with the drives standing still."""
        self.drive(np.zeros(len(self._given)))

    def drive(self, accelerations: Array) -> None:
        """Take a step with the accelerations of the joints of `Drives.given` given.

        They are so heavy that nothing but the force that accelerates them so moves them.
        """
        data, given, step = self.data, self._given, self.step
        rates = data.qvel[given] + step * accelerations
        places = data.qpos[self._given_places] + 0.5 * step * (data.qvel[given] + rates)
        heavy = self._heavy
        self.model.dof_armature[given] = heavy
        data.qfrc_applied[:] = 0.0
        data.qfrc_applied[given] = heavy * accelerations
        self._feed_back(0.0, 0.0)
        self._advance(lambda: self._put(places, rates))
        self.model.dof_armature[given] = self._armature[given]

    def free(self, tau: Array) -> None:
        """Take a step under generalized forces tau (n,), of which those of joints count."""
        self._feed_back(0.0, 0.0)
        self._push(tau)

    def controlled(self, tau: Array) -> None:
        """Take a step under tau - kp q - kd q' of the driven joints."""
        self._feed_back(self._kp, self._kd)
        self._push(tau)

    def _push(self, tau: Array) -> None:
        self.data.qfrc_applied[:] = 0.0
        self.data.qfrc_applied[self._degrees] = tau[self._joints]
        self._advance()

    def _put(self, places: Array, rates: Array) -> None:
        self.data.qpos[self._given_places] = places
        self.data.qvel[self._given] = rates

    def _advance(self, ending: Any = None) -> None:
        self.qdd[:] = self.qd
        self.mujoco.mj_step(self.model, self.data, self._steps)
        if not np.isfinite(self.data.qvel).all():
            raise StateError('mujoco: the state must be finite, got one that is not')
        if ending is not None:
            ending()
        self._read()
        np.subtract(self.qd, self.qdd, out=self.qdd)
        self.qdd /= self.step

    # ---- reading

    def _read(self) -> None:
        """Evaluate MuJoCo's state and project it on the coordinates."""
        self.mujoco.mj_forward(self.model, self.data)
        data = self.data
        self.q[self._joints] = data.qpos[self._places]
        self.qd[self._joints] = data.qvel[self._degrees]
        np.put(self.q, self._flexible, self._projection @ data.qpos[self._hinge_places])
        np.put(self.qd, self._flexible, self._projection @ data.qvel[self._hinge_degrees])
        if self._floating is not None:
            self._read_base(*self._floating)

    def _read_base(self, before: Array, behind: Array) -> None:
        """Write the coordinates of a floating base: position and rotation vector of its link."""
        data, place, degree = self.data, self._base_place, self._base_degree
        at, rotation = self.robot.base_indices, np.zeros(9)
        self.mujoco.mju_quat2Mat(rotation, data.qpos[place + 3 : place + 7])
        body = pose_of(data.qpos[place : place + 3], rotation.reshape(3, 3))
        link = body @ np.linalg.inv(behind)
        spin = body[:3, :3] @ data.qvel[degree + 3 : degree + 6]
        velocity = data.qvel[degree : degree + 3] + np.cross(spin, link[:3, 3] - body[:3, 3])
        turn = before[:3, :3].T
        phi = rotation_vectors(turn @ link[:3, :3])
        self.q[at[:3]] = turn @ (link[:3, 3] - before[:3, 3])
        self.q[at[ATTITUDE]] = phi
        self.qd[at[:3]] = turn @ velocity
        self.qd[at[ATTITUDE]] = np.linalg.solve(left_jacobians(phi), turn @ spin)

    def sensor_values(self) -> Array:
        """Return the values (sensors,) of the tree's sensors; the array is used again."""
        for place, sensor in enumerate(self.robot.tree.sensors):
            self._values[place] = self.data.sensor(sensor.name).data[0]
        return self._values

    def inertial_values(self) -> Array:
        """Return the values of all sensors, of which those of inertial ones count."""
        tree = self.robot.tree
        values = np.zeros(len(tree.sensor_names))
        for sensor in tree.inertial_sensors:
            names = [f'{sensor.name}/{INERTIAL_TAGS[each]}' for each in sensor.kind.vectors]
            parts = [self.data.sensor(name).data for name in names]
            values[sensor.first : sensor.first + len(sensor.parts)] = np.concatenate(parts)
        return values

    def tip_deflections(self, position: Array, rate: Array) -> None:
        """Write the deflections (6 k,) of the beams' tips and their rates, beam frames."""
        data, kinds = self.data, self.mujoco.mjtObj
        for k, (link, length) in enumerate(self._beams):
            site, frame = data.site(f'{link}/tip'), data.body(link)
            turn = frame.xmat.reshape(3, 3).T
            tip, root = np.zeros((2, 6))  # angular velocity first, world axes
            self.mujoco.mj_objectVelocity(self.model, data, kinds.mjOBJ_SITE, site.id, tip, 0)
            self.mujoco.mj_objectVelocity(self.model, data, kinds.mjOBJ_XBODY, frame.id, root, 0)
            arm = site.xpos - frame.xpos
            phi = rotation_vectors(turn @ site.xmat.reshape(3, 3))
            at = slice(6 * k, 6 * k + 3)
            turned = slice(6 * k + 3, 6 * k + 6)
            position[at] = turn @ arm
            position[at.start] -= length
            position[turned] = phi
            rate[at] = turn @ (tip[3:] - root[3:] - np.cross(root[:3], arm))
            rate[turned] = np.linalg.solve(left_jacobians(phi), turn @ (tip[:3] - root[:3]))
