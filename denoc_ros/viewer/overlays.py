"""Arrows of torques and reactions, and where loops close, on a page."""

from __future__ import annotations

from typing import Any

import numpy as np

from denoc_ros.dynamics.reactions import Reactions, reactions
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import DenocError
from denoc_ros.model.tree import JointKind
from denoc_ros.simulation.recorded.snapshot import Snapshot
from denoc_ros.types import Array
from denoc_ros.viewer.outline import Colour, reach

LONGEST = 0.22  # of the robot's reach: the arrow of the largest that was seen
TORQUE: Colour = (22, 140, 90)
REACTION: Colour = (235, 130, 20)
REACTION_MOMENT: Colour = (140, 70, 190)
PARENT_PIN: Colour = (210, 40, 120)
CHILD_PIN: Colour = (30, 30, 30)
LEAST = 1e-3  # of the largest: shorter arrows are left out
NOTHING = 1e-6  # N, N m: what rounding leaves of forces


class Arrows:
    """Arrows of one unit; the largest ever seen has the longest.

    Parameters
    ----------
    reach : float [m]
        Of the robot.
    colour : red, green, blue of 0 .. 255
    """

    def __init__(self, scene: Any, name: str, reach: float, colour: Colour) -> None:
        self.largest = 0.0
        self._length = LONGEST * reach
        self._none = np.zeros((1, 2, 3), np.float32)
        self._handle = scene.add_arrows(
            f'/{name}',
            self._none,
            colour,
            shaft_radius=0.005 * reach,
            head_radius=0.014 * reach,
            head_length=0.04 * reach,
            visible=False,
        )

    def draw(self, feet: Array, vectors: Array) -> None:
        """Draw vectors (k, 3) from points (k, 3) of the base frame."""
        sizes = np.linalg.norm(vectors, axis=1)
        largest = float(sizes.max(initial=0.0))
        self.largest = max(self.largest, largest) if largest > NOTHING else self.largest
        drawn = sizes > max(NOTHING, LEAST * self.largest)
        self._handle.visible = bool(drawn.any())
        if drawn.any():
            tips = feet[drawn] + self._length / self.largest * vectors[drawn]
            self._handle.points = np.stack([feet[drawn], tips], axis=1).astype(np.float32)

    def hide(self) -> None:
        """Draw none."""
        self._handle.visible = False


class Overlays:
    """Arrows of a moment's torques, forces and reactions."""

    def __init__(self, scene: Any, robot: Robot) -> None:
        self._robot = robot
        size = reach(robot)
        self.torques = Arrows(scene, 'torques', size, TORQUE)
        self.forces = Arrows(scene, 'reaction_forces', size, REACTION)
        self.moments = Arrows(scene, 'reaction_moments', size, REACTION_MOMENT)
        self._turning = [
            (body.name, body.joint.name, body.joint.axis)
            for body in robot.tree.bodies
            if body.joint is not None and body.joint.kind is not JointKind.FIXED
        ]
        loops = robot.tree.loops
        parents = [loop.parent.frame for loop in loops]
        children = [loop.child.frame for loop in loops]
        self._pins = (
            [
                _Pins(scene, 'parents', parents, PARENT_PIN, 0.016 * size, 0.45),
                _Pins(scene, 'children', children, CHILD_PIN, 0.009 * size, 1.0),
            ]
            if loops
            else []
        )

    def draw_torques(self, moment: Snapshot, drawn: Array) -> None:
        """Draw the actuators' torques along the joints' axes, at coordinates as drawn (n,)."""
        if moment.torque is None:
            self.torques.hide()
            return
        feet, vectors = [], []
        for link, joint, axis in self._turning:
            value = moment.torque.get(joint, np.nan)
            if np.isfinite(value):
                pose = self._robot.frame_pose(link, drawn)
                feet.append(pose[:3, 3])
                vectors.append(value * (pose[:3, :3] @ axis))
        self.torques.draw(np.reshape(feet, (-1, 3)), np.reshape(vectors, (-1, 3)))

    def draw_reactions(self, moment: Snapshot, drawn: Array) -> None:
        """Draw the reactions of joints and loops, at coordinates as drawn (n,)."""
        found = reactions_of(self._robot, moment)
        if found is None:
            self.hide_reactions()
            return
        tree, robot = self._robot.tree, self._robot
        origins = [
            (robot.frame_pose(body.name, drawn) @ body.frame)[:3, 3]
            for body in tree.bodies
            if body.segment == 1
        ]
        joints = [wrench for wrench, body in zip(found.joints, tree.bodies, strict=True)
                  if body.segment == 1]  # fmt: skip
        pins = [robot.frame_pose(loop.child.frame, drawn)[:3, 3] for loop in tree.loops]
        feet = np.reshape([*origins, *pins], (-1, 3))
        wrenches = np.concatenate([np.reshape(joints, (-1, 6)), found.loops])
        self.forces.draw(feet, wrenches[:, :3])
        self.moments.draw(feet, wrenches[:, 3:])

    def hide_reactions(self) -> None:
        """Draw no reactions."""
        self.forces.hide()
        self.moments.hide()

    def draw_loops(self, drawn: Array | None) -> None:
        """Draw both frames of every loop at coordinates as drawn (n,); None: not."""
        for pins in self._pins:
            pins.draw(self._robot, drawn)


class _Pins:
    """Balls at one side's frames of all loops."""

    def __init__(
        self,
        scene: Any,
        name: str,
        frames: list[str],
        colour: Colour,
        radius: float,
        opacity: float,
    ) -> None:
        from trimesh.creation import icosphere

        ball, count = icosphere(subdivisions=2, radius=radius), len(frames)
        self._frames = frames
        self._handle = scene.add_batched_meshes_simple(
            f'/loops/{name}',
            np.asarray(ball.vertices),
            np.asarray(ball.faces),
            np.tile([1.0, 0.0, 0.0, 0.0], (count, 1)),
            np.zeros((count, 3)),
            batched_colors=colour,
            opacity=opacity,
        )

    def draw(self, robot: Robot, q: Array | None) -> None:
        self._handle.visible = q is not None
        if q is not None:
            places = [robot.frame_pose(frame, q)[:3, 3] for frame in self._frames]
            self._handle.batched_positions = np.array(places, np.float32)


def reactions_of(robot: Robot, moment: Snapshot) -> Reactions | None:
    """Return the reactions of a moment: under its torque, or with the joints held.

    Parameters
    ----------
    moment : Snapshot
        Without torques the joints are taken to move on at their rates; without rates to rest.

    Returns
    -------
    Reactions or None
        None where the dynamics have no answer (a singular configuration).
    """
    q = moment.q
    qd = np.zeros(robot.n) if moment.qd is None else moment.qd
    try:
        if moment.torque is not None:
            tau = np.zeros(robot.n)
            known = [moment.torque.get(name, 0.0) for name in robot.joint_names]
            tau[robot.joint_indices] = np.nan_to_num(known)
            qdd, multipliers = robot.constrained_forward_dynamics(q, qd, tau)
        elif robot.tree.loops:
            moved = len(robot.tree.non_mimic_joints)
            qd = np.zeros(robot.n)
            _, qdd, multipliers = robot.constrained_hybrid_dynamics(q, qd, np.zeros(moved))
        else:
            qdd, multipliers = np.zeros(robot.n), np.zeros(0)
            held = np.zeros(len(robot.joint_names))
            qdd[robot.free_indices] = robot.hybrid_dynamics(q, qd, held)[1]
        return reactions(robot, q, qd, qdd, multipliers)
    except DenocError:
        return None
