"""All coordinates of a robot from the messages of one topic."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from denoc_ros.dynamics.driven_motion import DrivenMotion, driven_motion
from denoc_ros.dynamics.measured_side import described_coordinates
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import SolverError, StateError
from denoc_ros.runtime.conversions import JointStateReader, joint_names
from denoc_ros.runtime.input_error import InputError
from denoc_ros.types import Array

FARTHEST = 1e6  # rad or m: a coordinate beyond cannot be drawn


class _StateLayout(NamedTuple):
    """How messages with the same names are read; no motion: they name the coordinates at places.

    Springs whose joints are measured on the link side may be missing there: the links then stand
    where the joints are.
    """

    names: tuple[str, ...]
    reader: JointStateReader
    motion: DrivenMotion | None
    places: NDArray[np.int64]


class LiveState:
    """Reads a modal state, or the joints alone: the links are straight then.

    Mimic joints and loops give the joints that a message does not name; joints that nothing
    gives stay where the posture has them.

    Parameters
    ----------
    robot : Robot
        Its workspace is used: do not share it with another thread.
    posture : (n,) array
        Coordinates near which loops are closed.

    Attributes
    ----------
    q, qd : (n,) arrays
        The coordinates of the last good message, and their rates.
    torque : dict of str to float
        What it said of the joints' effort [N m or N].
    heard, bent : bool
        Whether there was one, and whether it had the amplitudes.
    """

    def __init__(self, robot: Robot, posture: Array) -> None:
        self._robot = robot
        self._posture = posture
        self.q: Array = posture.copy()
        self.qd: Array = np.zeros(robot.n)
        self.torque: dict[str, float] = {}
        self.heard = self.bent = False
        self._layout: _StateLayout | None = None

    def read(self, raw: bytes, admit: Callable[[int], None]) -> None:
        """Take a message.

        Parameters
        ----------
        raw : bytes
            A sensor_msgs/JointState.
        admit : callable
            Takes the stamp [ns]; may raise InputError.

        Raises
        ------
        InputError
            As of JointStateReader.read; `unknown_joint`, `missing_joint`, `out_of_reach` or
            `open_loop`; the attributes keep what they had.
        """
        names = joint_names(raw)
        layout = self._layout
        if layout is None or names != layout.names:
            layout = self._learn(names)
        reader = layout.reader
        reader.read(raw, admit)
        if np.abs(reader.position).max() > FARTHEST:
            raise InputError(
                'out_of_reach',
                f'position must be within {FARTHEST:g}, got {reader.position.tolist()}',
            )
        self.q, self.qd = self._coordinates(layout)
        self.heard, self.bent, self._layout = True, layout.motion is None, layout
        joints = self._robot.joint_names
        efforts = zip(reader.joints, reader.effort.tolist(), strict=True)
        self.torque = {j: e for j, e in efforts if j in joints} if reader.has_effort else {}

    def _learn(self, names: tuple[str, ...]) -> _StateLayout:
        """Learn the layout of messages with these names."""
        robot = self._robot
        for known in (robot.coordinate_names, described_coordinates(robot)):
            if set(known) <= set(names):
                reader = JointStateReader(known, allow_extra=True)
                places = [robot.coordinate_names.index(name) for name in known]
                return _StateLayout(names, reader, None, np.array(places, dtype=np.int64))
        driven = [name for name in robot.tree.non_mimic_joints if name in names]
        if not driven:
            raise InputError(
                'unknown_joint',
                f'message must name joints of {list(robot.joint_names)}, got {list(names)}',
            )
        try:
            motion = driven_motion(robot, driven, None, self._posture, flexible=False)
        except (StateError, SolverError) as error:
            raise InputError('missing_joint', str(error)) from error
        return _StateLayout(
            names, JointStateReader(driven, allow_extra=True), motion, motion.index
        )

    def _coordinates(self, layout: _StateLayout) -> tuple[Array, Array]:
        """Return coordinates and rates (n,) by the message that was read last."""
        reader, motion = layout.reader, layout.motion
        if motion is None:
            q, qd = np.zeros((2, self._robot.n))
            q[layout.places], qd[layout.places] = reader.position, reader.velocity
            return q, qd
        # loops are closed from where they were
        q = (self.q if layout is self._layout else motion.posture).copy()
        qd = np.zeros(self._robot.n)
        try:
            motion.positions(q, reader.position)
            motion.rates(qd, reader.velocity)
        except (StateError, SolverError) as error:
            raise InputError('open_loop', str(error)) from error
        return q, qd
