"""A node with a robot's model and a real-time loop."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from rclpy.qos import QoSProfile, ReliabilityPolicy

from denoc_ros.nodes.guarding import Guard
from denoc_ros.nodes.inputs import Handler, Input, never_heavy
from denoc_ros.nodes.model_node import ModelNode
from denoc_ros.runtime.conversions import LONGEST
from denoc_ros.runtime.parameters import ParameterTable
from denoc_ros.runtime.realtime import lock_memory
from denoc_ros.runtime.safety import InputMonitor
from denoc_ros.runtime.status import ERROR, Status, loop_status, realtime_status
from denoc_ros.runtime.timing import RealtimeLoop

# what a flood at 10 kHz brings between two ticks at 1 kHz, and some more
WITHIN_A_TICK = 16  # messages
STANDSTILL = 0.5  # s without a tick that are an error
PATIENCE = 1.0  # s of failing ticks that nothing can be done about
ASIDE_PERIOD = 0.02  # s between looks at what the loop does not take


class RobotNode(ModelNode):
    """Loads the robot on configure and runs `tick` in a thread of its own while active.

    The loop takes its inputs itself, at the beginning of a tick: a callback in another thread
    would hold the interpreter just when the loop is due.

    A node overrides `prepare` (build and run once everything that `tick` uses), `tick` and, where
    it has more to say, `statuses`.

    Attributes
    ----------
    loop : RealtimeLoop or None
        The loop while active.
    """

    def __init__(self, name: str, table: ParameterTable, **options: Any) -> None:
        super().__init__(name, table, **options)
        self.loop: RealtimeLoop | None = None
        self._inputs: list[Input] = []
        self._tick_guard = Guard(self.to_log.append)
        self._failing_since = math.inf

    # ---- inputs

    def listen_in_loop(
        self,
        message_type: type,
        topic: str,
        handle: Handler,
        is_heavy: Callable[[bytes], bool] = never_heavy,
        depth: int = WITHIN_A_TICK,
    ) -> InputMonitor:
        """Subscribe as `listen` does; the loop takes the messages, but for heavy ones.

        `depth` of them wait for a tick, the newest.
        """
        if not self._inputs:
            self.create_timer(ASIDE_PERIOD, self._take_aside, clock=self.steady_clock)
        qos = QoSProfile(depth=depth, reliability=ReliabilityPolicy.BEST_EFFORT)
        added = self.subscribe(message_type, topic, handle, qos, is_heavy)
        added.longest = LONGEST
        self.take_aside(added.subscription)
        self._inputs.append(added)
        return added.monitor

    def _take_inputs(self) -> None:
        for each in self._inputs:
            each.take()

    def _take_aside(self) -> None:
        """Process the messages that the loop deferred, or all of them while there is no loop."""
        if self.loop is None or not self.loop.running:
            self._take_inputs()
        for each in self._inputs:
            each.take_heavy()

    def _turn(self, steps: int) -> None:
        try:
            self._take_inputs()
            self.tick(steps)
            self._failing_since = math.inf
        except Exception as error:
            self._on_failure(error, self.clock.now())

    def guarded(self, act: Callable[[float], None], now: float) -> None:
        """Do what a tick does outside of the loop; a failure counts as one of a tick."""
        try:
            act(now)
        except Exception as error:
            self._on_failure(error, now)

    def _on_failure(self, error: Exception, now: float) -> None:
        """Count and log a failure of the tick; end the loop where nothing else is left."""
        self._tick_guard.note('tick', error)
        self._failing_since = min(self._failing_since, now)
        if not self.rescue() and now - self._failing_since > PATIENCE:
            raise error

    @property
    def tick_failures(self) -> int:
        """Ticks that ended with an exception."""
        return self._tick_guard.failures['tick']

    # ---- what a node of this kind does

    def tick(self, steps: int) -> None:
        """Advance by `steps` periods; called in the loop thread."""

    def rescue(self) -> bool:
        """Act safely after a failed tick; say whether this can continue indefinitely."""
        return False

    def begin(self) -> None:
        """Do what is to be done just before the loop starts."""

    # ---- loop

    def configure(self) -> None:
        """Load the robot, build all that the loop uses, compile it by using it."""
        self.realtime_options.update(lock_memory(self.settings.flag('lock_memory')))
        super().configure()

    def activate(self) -> None:
        """Start the loop."""
        self._take_aside()
        self.begin()
        settings = self.settings
        self.loop = RealtimeLoop(
            settings.number('update_rate'),
            self._turn,
            settings.integer('thread_priority'),
            settings.integer('cpu_affinity'),
            self.clock,
        )
        self.loop.start()

    def deactivate(self) -> None:
        """Stop the loop."""
        if self.loop is not None:
            self.loop.stop()

    @property
    def period(self) -> float:
        """Period of the loop [s]."""
        return 1.0 / self.settings.number('update_rate')

    def statuses(self) -> list[Status]:
        """Return how the loop does and what it asked for; a loop that failed fails the node."""
        loop = self.loop
        if loop is None:
            return [Status('loop', message=self.state)]
        status = loop_status(
            loop.statistics(),
            loop.period,
            self.settings.number('diagnostics.threshold.late_share'),
        )
        if loop.failure is not None:
            self.fatal = f'loop failed: {type(loop.failure).__name__}: {loop.failure}'
            status.worsen(ERROR, self.fatal)
        status.values['state'] = self.state
        status.values['failures'] = self.tick_failures
        if self.tick_failures > self._tick_guard.reported:
            status.worsen(ERROR, self._tick_guard.last)
        self._tick_guard.reported = self.tick_failures
        behind = self.clock.now() - loop.deadline
        if loop.running and behind > STANDSTILL + 2.0 * loop.period:
            status.worsen(ERROR, f'no tick for {behind:.1f} s')
        loop_options = {f'loop {name}': what for name, what in loop.realtime_options.items()}
        return [status, realtime_status({**loop_options, **self.realtime_options})]
