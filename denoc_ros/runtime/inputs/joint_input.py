"""Joint states of a node: read, judged, and replaced where they contradict each other."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

from denoc_ros.dynamics.robot import Robot
from denoc_ros.runtime.inputs.input_monitor import InputError, InputMonitor
from denoc_ros.runtime.inputs.joint_gate import JointSample, joint_gate
from denoc_ros.runtime.inputs.message_readers import JointStateReader
from denoc_ros.runtime.inputs.partial_joints import PartialJoints
from denoc_ros.runtime.inputs.velocity_check import VelocityCheck
from denoc_ros.runtime.loop.status import WARN, Status
from denoc_ros.runtime.safety.motion_bounds import MotionBounds
from denoc_ros.types import Array


class JointInput:
    """Joint states of one topic as samples that continue one motion.

    Parameters
    ----------
    robot : Robot
        Its limits and continuous joints count.
    joints : sequence of str
        n joints.
    bounds : MotionBounds
        A message beyond these is refused.
    allow_extra : bool
        Whether messages may also have joints that the robot does not have.
    rewinds : bool
        As of :class:`VelocityCheck`.
    judges_effort : bool
        Whether an effort that does not continue the motion counts as wrong.
    timeout : callable, optional
        Returns how old the last message of a joint may be that comes in other messages [s];
        default: all joints come in one message.
    """

    def __init__(
        self,
        robot: Robot,
        joints: Sequence[str],
        bounds: MotionBounds,
        allow_extra: bool,
        rewinds: bool = False,
        judges_effort: bool = False,
        timeout: Callable[[], float] | None = None,
    ) -> None:
        self._parts = PartialJoints(joints, allow_extra, robot.joint_names)
        self._timeout = timeout
        self._reader = JointStateReader(joints, allow_extra, robot.joint_names)
        self._bounds = bounds
        self._gate = joint_gate(robot, joints, judges_effort)
        self._check = VelocityCheck(joints, self._gate.velocity, rewinds)
        self._restarts_reported = 0
        self._is_reset = False

    @property
    def position(self) -> Array:
        """Positions (n,) of the last sample, without jumps by a turn."""
        return self._gate.position

    def reset(self) -> None:
        """Forget the motion: the next message passes. Any thread may call this."""
        # The thread that takes messages resets the parts: the first message after this call must
        # not be judged by the motion before it.
        self._is_reset = True

    def take(
        self,
        raw: bytes,
        now: float,
        monitor: InputMonitor,
        refuse: Callable[[InputMonitor, InputError], None],
        with_effort: bool = False,
    ) -> list[JointSample]:
        """Read a message that arrived at a time [s]; return the samples that count from now on.

        None while a message waits for the next one to confirm it. Several where the motion is
        described again: the first of them restarts it.

        Parameters
        ----------
        refuse : callable
            Takes the refusal of a message that waited.
        with_effort : bool
            Whether the message must have effort.

        Raises
        ------
        InputError
            As of :meth:`JointStateReader.read` and :meth:`MotionBounds.require`.
        """
        reader, check = self._reader, self._check
        if self._is_reset:
            self._is_reset = False
            self._gate.reset()
            self._parts.reset()
            check.reset()
        try:
            reader.read(raw, with_effort=with_effort)
        except InputError as error:
            if error.cause != 'missing_joint' or self._timeout is None:
                raise
            if not self._parts.read(raw, now, self._timeout()):
                return []
            sample = self._joined(now, with_effort)
        else:
            sample = JointSample(
                1e-9 * reader.stamp_ns if reader.stamp_ns else now,
                reader.position,
                reader.velocity if reader.has_velocity else None,
                effort=reader.effort if reader.has_effort else None,
                stamp_ns=reader.stamp_ns,
                arrival=now,
            )
        # Velocities that are not used may be beyond their bounds.
        self._bounds.require(sample.position, None if check.reason else sample.velocity)
        monitor.accept(sample.stamp_ns, now)
        gate = self._gate
        passed = gate.offer(sample, partial(refuse, monitor))
        monitor.revise(len(passed))
        taken = [each for one in passed for each in check.take(one, gate.deviation)]
        gate.ignores_velocity = bool(check.reason)
        return taken

    def _joined(self, now: float, with_effort: bool) -> JointSample:
        """Return the state that messages of some joints each make."""
        parts = self._parts
        if with_effort and parts.effort is None:
            raise InputError('missing_effort', 'effort must be given for each joint, got none')
        time = 1e-9 * parts.stamp_ns if parts.stamp_ns else now
        return JointSample(
            time, parts.position, parts.velocity, None, parts.effort, parts.stamp_ns, now
        )

    def status(self) -> Status:
        """Return the state of the joint states, with warnings for events since the last report."""
        restarts = self._gate.restarts
        status = Status('joint states', values={'restarts': restarts})
        status.values['velocity'] = self._check.reason or 'used'
        if restarts > self._restarts_reported:
            status.worsen(WARN, 'positions jumped and stayed: the motion starts again')
        self._restarts_reported = restarts
        if reason := self._check.reason:
            status.worsen(WARN, f'{reason}; velocities are derived from positions')
        return status
