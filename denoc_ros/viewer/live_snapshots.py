"""The newest messages of topics: a robot's coordinates, and snapshots to draw."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from denoc_ros.dynamics.driven.driven_motion import DrivenMotion, driven_motion
from denoc_ros.dynamics.driven.measured_side import described_coordinates
from denoc_ros.dynamics.elastic.deflection import TipDeflections
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import SolverError, StateError
from denoc_ros.runtime.inputs.input_monitor import InputError
from denoc_ros.runtime.inputs.message_readers import JointStateReader, joint_names
from denoc_ros.simulation.recorded.snapshot import (
    Snapshot,
    deflection_channel,
    residual_channel,
    torque_channels,
)
from denoc_ros.types import Array

FARTHEST = 1e6  # rad or m: a coordinate beyond cannot be drawn
# what the charts call a source, by the node that its topic is of
WORDS = {'predictor': 'predicted', 'plant': 'true'}


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


class LiveSnapshots:
    """Newest message of every topic, and snapshots of the fresh ones.

    Parameters
    ----------
    robot : Robot
        Its workspace is used.
    states : sequence of str
        Topics that say where the robot is; the first that is fresh is drawn.
    torque, residual : str
        Topics of commanded torque and of sensor residuals; '' for none.
    timeout : float
        s after which a topic's last word counts no more.
    clock : callable, optional
        The robot's time [s].

    Attributes
    ----------
    source : str
        The topic that the last snapshot is of; '' before there is one.
    """

    def __init__(
        self,
        robot: Robot,
        posture: Array,
        states: Sequence[str],
        torque: str = '',
        residual: str = '',
        timeout: float = 0.5,
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        self.source = ''
        self._robot = robot
        self._timeout = timeout
        self._clock = clock
        self._start = clock()
        self._states = {topic: LiveState(robot, posture) for topic in states}
        self._values = {topic: NamedValues() for topic in (torque, residual) if topic}
        self._torque, self._residual = torque, residual
        self._heard: dict[str, float] = {}
        self._deflections = TipDeflections(robot)
        self._shown = _bending(robot, self._deflections.names)
        self._torque_channels = torque_channels(robot.tree)

    @property
    def topics(self) -> tuple[str, ...]:
        """The topics that are taken, all of type sensor_msgs/JointState."""
        return (*self._states, *self._values)

    def take(self, topic: str, raw: bytes, admit: Callable[[int], None]) -> None:
        """Take a message; InputError where it is refused."""
        (self._states.get(topic) or self._values[topic]).read(raw, admit)
        self._heard[topic] = self._clock()

    def forget(self) -> None:
        """Discard all messages, and restart the time."""
        self._heard.clear()
        self._start = self._clock()
        self.source = ''

    def newest(self, now: float) -> Snapshot | None:
        """Return the snapshot to draw at `now` [s of the clock], None where nothing is fresh."""
        fresh = [topic for topic in self._states if self._is_fresh(topic, now)]
        self.source = fresh[0] if fresh else ''
        if not fresh:
            return None
        state = self._states[fresh[0]]
        measured = next((self._states[t].torque for t in fresh if self._states[t].torque), {})
        torque = self._torques(now) or measured
        channels: dict[str, float] = {}
        for topic in fresh:
            channels.update(self._bends(topic))
        channels.update({self._torque_channels[name]: value for name, value in torque.items()})
        if self._is_fresh(self._residual, now):
            residuals = self._values[self._residual].position
            channels.update({residual_channel(name): each for name, each in residuals.items()})
        return Snapshot(now - self._start, state.q, state.qd, torque or None, channels)

    def wanted(self, now: float) -> list[str]:
        """Return the topics that are worth listening to at `now` [s].

        Joints alone say nothing new where a modal state and the commanded torque are fresh.
        """
        modal = any(s.bent and self._is_fresh(t, now) for t, s in self._states.items())
        known = modal and self._is_fresh(self._torque, now)
        plain = {t for t, state in self._states.items() if state.heard and not state.bent}
        return [topic for topic in self.topics if not (known and topic in plain)]

    def _is_fresh(self, topic: str, now: float) -> bool:
        return now - self._heard.get(topic, -np.inf) < self._timeout

    def _torques(self, now: float) -> dict[str, float]:
        """Return the commanded torque of the robot's joints."""
        if not self._is_fresh(self._torque, now):
            return {}
        said = self._values[self._torque].effort
        return {name: each for name, each in said.items() if name in self._torque_channels}

    def _bends(self, topic: str) -> dict[str, float]:
        state = self._states[topic]
        if not state.bent:
            return {}
        node = (topic.strip('/').split('/')[:-1] or [topic])[-1]
        position, _ = self._deflections.evaluate(state.q, state.qd)
        return {
            deflection_channel(WORDS.get(node, node), tip): float(position[place])
            for tip, place in self._shown
        }


class NamedValues:
    """The newest values of a topic of sensor_msgs/JointState, whatever it names.

    Attributes
    ----------
    position, effort : dict of str to float
        By name; effort is empty where the message has none.
    """

    def __init__(self) -> None:
        self.position: dict[str, float] = {}
        self.effort: dict[str, float] = {}
        self._reader = JointStateReader(())

    def read(self, raw: bytes, admit: Callable[[int], None]) -> None:
        """Take a message; raises as JointStateReader.read does."""
        names = joint_names(raw)
        if names != self._reader.joints:
            self._reader = JointStateReader(names)
        reader = self._reader
        reader.read(raw, admit)
        self.position = dict(zip(names, reader.position.tolist(), strict=True))
        efforts = zip(names, reader.effort.tolist(), strict=True)
        self.effort = dict(efforts) if reader.has_effort else {}


def _bending(robot: Robot, names: Sequence[str]) -> list[tuple[str, int]]:
    """Return the tips' components that have modes of their own, with their places."""
    beams = {body.name: body.beam for body in robot.tree.bodies if body.beam is not None}
    found = []
    for place, name in enumerate(names):
        link, _, component = name.rpartition('/')
        if link not in beams:  # component modes: displacements of its farthest frame
            if component in ('ux', 'uy', 'uz'):
                found.append((name, place))
            continue
        modes = dict(zip(('uy', 'uz', 'rx'), beams[link].modes, strict=True))
        if modes.get(component):
            found.append((name, place))
    return found
