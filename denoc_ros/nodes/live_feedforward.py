"""Services and live parameters of the feedforward node."""

from __future__ import annotations

import math
from typing import Any

from std_srvs.srv import SetBool

from denoc_ros.dynamics.feedforward import TorqueFeedforward
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import ConfigError
from denoc_ros.model.numbers import FAMILIES
from denoc_ros.nodes.model_node import is_override
from denoc_ros.nodes.robot_node import RobotNode
from denoc_ros.nodes.torque_feedback import TorqueFeedback
from denoc_ros.runtime.conversions import JointStateReader
from denoc_ros.runtime.following import FollowingConditions
from denoc_ros.runtime.input_monitor import InputMonitor
from denoc_ros.runtime.live_torque import LiveTorque, torque_feedforward
from denoc_ros.runtime.motion_bounds import MotionBounds, limits_of
from denoc_ros.runtime.parameters import ParameterTable, Settings, Value
from denoc_ros.runtime.phase_lock import PhaseLock
from denoc_ros.runtime.reference import ReferenceFollower
from denoc_ros.runtime.safety import TorqueLimiter, torque_limits
from denoc_ros.runtime.status import Status
from denoc_ros.runtime.torque_status import TorqueStatus
from denoc_ros.types import Array

TWISTS = ('odometry', 'odometry_accel', 'imu')  # what measures how a base turns
WATCH_PERIOD = 0.02  # s between looks at what the feedback needs gains for


class LiveFeedforward(RobotNode):
    """The feedforward node beside its loop.

    Its `prepare` makes what is declared here and not made here.
    """

    joints: list[str]
    limiter: TorqueLimiter
    bounds: MotionBounds
    follower: ReferenceFollower
    phase: PhaseLock | None
    torque: LiveTorque
    joint_input: InputMonitor
    q: Array
    _reader: JointStateReader
    _said: TorqueStatus
    _cause: str
    _message_time: int | None
    _takeovers: int

    sees_joint_states = True

    def __init__(self, table: ParameterTable, **options: Any) -> None:
        super().__init__('feedforward', table, **options)
        self.by_message = self.settings.text('trigger') == 'message'
        self.from_joints = self.settings.text('reference_source') == 'joint_states'
        self.conditions = FollowingConditions(self.settings, self.from_joints)
        self.create_service(SetBool, '~/enable', self._on_enable)
        self.add_trigger_service('~/stop', self._stop)
        self.add_trigger_service('~/reset', self._reset)
        self.add_trigger_service('~/reload_model', self._reload)
        self.feedback = TorqueFeedback(self)
        self._watches = False

    # ---- what depends on the model

    @property
    def flies(self) -> bool:
        """Whether thrusters hold a base that would float."""
        return self.settings.text('base') == 'free_flying'

    @property
    def drifts(self) -> bool:
        """Whether a base that floats reacts from a measured twist."""
        return self.settings.text('base') == 'drifting'

    @property
    def holds_base(self) -> bool:
        """Whether the base's motion is measured, or none."""
        return self.flies or (self.settings.text('base_motion') != 'off' and not self.drifts)

    def require_twist(self) -> None:
        """Refuse a base that drifts where nothing measures how it turns.

        Raises
        ------
        ConfigError
            With what may.
        """
        source = self.settings.text('base_motion')
        if self.drifts and source not in TWISTS:
            rule = f"must be one of {', '.join(TWISTS)} where 'base' is drifting, got {source!r}"
            raise ConfigError(self.get_fully_qualified_name(), [f"parameter 'base_motion' {rule}"])

    def floating_robot(self, settings: Settings) -> Robot | None:
        """Return the robot whose base would float, if thrusters hold it."""
        if self.floating is None or not self.flies:
            return None
        return self.floating.robot(settings.family(*FAMILIES))

    @property
    def in_hurry(self) -> bool:
        """Whether a loop in real time waits for the model."""
        return not (self.by_message or self.clock.is_simulated)

    def _build(self, robot: Robot, settings: Settings) -> TorqueFeedforward:
        posture = self.posture(robot, settings)
        return torque_feedforward(robot, self.joints, settings, posture, self.in_hurry)

    def _build_feedback(
        self, robot: Robot, settings: Settings, limits: Array, patience: float = 0.0
    ) -> None:
        posture = self.posture(robot, settings)
        self.feedback.build(robot, self.joints, settings, limits, posture, patience)
        if self.feedback.state.wanted and not self._watches:
            self._watches = True
            self.create_timer(WATCH_PERIOD, self._watch_beside, clock=self.steady_clock)

    def follow_clock(self) -> None:
        """Look at the time; who answers messages does not hold it."""
        super().follow_clock()
        if self.by_message and self.progress is not None and self.state == 'active':
            self.progress.tell(math.inf)

    def _watch_beside(self) -> None:
        """Watch, unless the ticks of simulated time do: then they wait for the gains."""
        if not self.clock.is_simulated:
            self._watch()

    def _watch(self) -> None:
        """Show the feedback the motion to come."""
        if self.state != 'active':
            return
        if self.follower.given:
            self.feedback.watch(self.follower, self.q)
        elif self.joint_input.received:
            self.feedback.watch(self.follower, self._reader.position)

    # ---- services and live parameters

    def _on_enable(self, request: Any, response: Any) -> Any:
        self.conditions.enable(bool(request.data))
        response.success = True
        response.message = 'enabled' if self.conditions.enabled else 'disabled: safe command'
        return response

    def _stop(self) -> str:
        """Stop until enabled again; the reference is dropped."""
        self.conditions.stopped = True
        if self.state in ('active', 'inactive'):
            self.follower.clear()
        return 'stopped: safe command until ~/enable'

    def _reset(self) -> str:
        """Forget reference, stamps and amplitudes."""
        if self.state in ('active', 'inactive'):
            self.follower.clear()
            self.torque.request_reset()
            self._message_time = None
        for monitor in self.monitors:
            monitor.reset()
        return 'reset: waiting for a reference'

    def _reload(self) -> str:
        """Read the robot again; its joints must be the same."""
        self.require_configured('to reload its model')
        model = self.read_model(self.settings)
        robot = self.changed_robot(self.settings, model)
        self.require_joints(robot)
        limits = torque_limits(robot, self.joints, self.settings)
        source = self._build(robot, self.settings)
        self._build_feedback(robot, self.settings, limits)
        self.bounds.update(limits_of(robot, self.joints))
        self.torque.replace(source, limits)
        self.robot = robot
        self.adopt_model(model, self.settings)
        return f'reloaded {robot.tree.name}'

    def settings_changed(self, settings: Settings, changes: dict[str, Value]) -> None:
        """Build a changed model beside the loop; the next tick takes it."""
        if self.state not in ('active', 'inactive'):
            return
        if any(is_override(n) or n.split('.')[0] in ('model', 'terms') for n in changes):
            robot = self.changed_robot(settings)
            limits = torque_limits(robot, self.joints, settings)
            source = self._build(robot, settings)
            self._build_feedback(robot, settings, limits)
            self.torque.replace(source, limits)
            self.robot = robot
        elif any(n.startswith('feedback.') for n in changes):
            limits = torque_limits(self.robot, self.joints, settings)
            self._build_feedback(self.robot, settings, limits)
        self.conditions.update(settings)

    def save(self) -> None:
        """Leave no process behind, whatever hangs."""
        self.feedback.close()

    # ---- diagnostics

    def statuses(self) -> list[Status]:
        """Return loop and torque."""
        found = super().statuses()
        if self.state not in ('active', 'inactive'):
            return found
        more = {
            'enabled': self.conditions.enabled,
            'model': self.torque.source.model,
            'joints': ' '.join(self.joints),
            'takeovers': self._takeovers,
        }
        if self.phase is not None:
            more['synchronous'] = self.phase.is_steady
        status = self._said.status(self._cause, self.limiter, self.torque.failures, more)
        return [*found, status, *self.feedback.statuses()]
