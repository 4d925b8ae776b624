"""Simulated time: /clock as it comes, progress told to who makes it, and a node that makes it."""

from __future__ import annotations

import math
import struct
import time
from bisect import bisect_right
from collections.abc import Callable, Sequence
from typing import Any

from builtin_interfaces.msg import Time as TimeMessage
from rclpy.clock_type import ClockType
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.time import Time
from rosgraph_msgs.msg import Clock
from std_msgs.msg import MultiArrayDimension, UInt64MultiArray

from denoc_ros.bags.cdr import CdrError, CdrReader, stamp_fields
from denoc_ros.nodes.base.inputs import Input, arrived, subscribe_aside
from denoc_ros.nodes.base.messages import EVERY_MESSAGE, STAMP, exact_bytes, listeners, raw_publish
from denoc_ros.runtime.loop.clocks import SourceClock
from denoc_ros.runtime.loop.status import ERROR, WARN, Status

CLOCK_TOPIC = '/clock'
ROS_TIME = ClockType.ROS_TIME
KEPT = 20_000  # times kept for messages that are looked at later
PROGRESS_TOPIC = '_time'  # hidden, as it is of the machine: recorders leave it out
PROGRESS = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)
VALUES = struct.Struct('<QQ')  # the last bytes of a message
FOREVER = (1 << 64) - 1
LOOK = 0.02  # s of wall time at most for one look for answers
LOST = 0.5  # s of wall time that a command may take that its sender has counted
SLOW = 1.0  # s of wall time for an answer after which the status names who owes it
BEST_EFFORT = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)


class WaitSet:
    """Waits for messages of subscriptions that no executor serves.

    A callback of an executor for each message would cost several times as much.
    """

    def __init__(self, context: Any, subscriptions: list[Any]) -> None:
        self._handles = [each.handle for each in subscriptions]
        counts = len(self._handles), 0, 0, 0, 0, 0
        self._set = rclpy_implementation.WaitSet(*counts, context.handle)

    def wait(self, timeout: float) -> None:
        """Wait for a message, at most so long [s]."""
        wait_set = self._set
        wait_set.clear_entities()
        for handle in self._handles:
            wait_set.add_subscription(handle)
        wait_set.wait(round(1e9 * timeout))


class ClockInput:
    """Messages of /clock, and the node's own ROS clock set by them.

    rclpy's time source has a callback of the executor for each message; its subscription is
    replaced.

    Parameters
    ----------
    node : DenocNode
        Its parameter `use_sim_time` is true.
    depth : int
        Messages that wait; with more than 1 the times are kept for :meth:`time_of`.
    """

    def __init__(self, node: Any, depth: int = 1) -> None:
        release_clock(node)
        self._node = node
        self._clock, self._depth, self._guard = node.get_clock(), depth, node.guard
        self._reliability = ReliabilityPolicy.BEST_EFFORT  # suits every publisher
        self._subscribe()
        self._sent: list[int] = []
        self._told: list[int] = []

    def _subscribe(self) -> None:
        qos = QoSProfile(depth=self._depth, reliability=self._reliability)
        self._subscription = subscribe_aside(self._node, Clock, CLOCK_TOPIC, qos)
        self._waits = WaitSet(self._node.context, [self._subscription])

    def miss_nothing(self) -> None:
        """Subscribe as reliable where all who publish are; no thread may be waiting."""
        offers = self._node.get_publishers_info_by_topic(CLOCK_TOPIC)
        reliable = [each.qos_profile.reliability == ReliabilityPolicy.RELIABLE for each in offers]
        wanted = ReliabilityPolicy.BEST_EFFORT
        if offers and all(reliable):
            wanted = ReliabilityPolicy.RELIABLE
        if offers and wanted != self._reliability:
            self._reliability = wanted
            self._node.drop(self._subscription)
            self._subscribe()

    @property
    def last_sent_ns(self) -> int:
        """When the newest message that is kept was sent [ns, system's clock]; 0: there is none."""
        return self._sent[-1] if self._sent else 0

    @property
    def publishers(self) -> int:
        """How many publish the time."""
        return int(self._subscription.handle.get_publisher_count())

    def receive(self, timeout: float) -> int | None:
        """Wait at most so long [s] for a message; return the newest time [ns], None: none came."""
        newest = self._take()
        if newest is None and timeout > 0.0:
            self._waits.wait(timeout)
            newest = self._take()
        if newest is not None:
            self._clock.set_ros_time_override(Time(nanoseconds=newest, clock_type=ROS_TIME))
        return newest

    def time_of(self, sent_ns: int) -> int | None:
        """Time on /clock [ns] when a message was sent [ns, system's clock]."""
        place = bisect_right(self._sent, sent_ns)
        return self._told[place - 1] if place else None

    def _take(self) -> int | None:
        newest = None
        for raw, _, sent_ns, _ in arrived(self._subscription, self._depth):
            try:
                newest = time_ns(raw)
            except CdrError as error:
                self._guard.note(f'topic {CLOCK_TOPIC}', error)
                continue
            if self._depth > 1:
                self._sent.append(sent_ns)
                self._told.append(newest)
        if len(self._sent) > KEPT:
            del self._sent[: KEPT // 2], self._told[: KEPT // 2]
        return newest


def release_clock(node: Any) -> bool:
    """Drop the subscription of rclpy's time source; say whether there was one."""
    source = node._time_source
    if source._clock_sub is None:
        return False
    node.destroy_subscription(source._clock_sub)
    source._clock_sub = None
    return True


def time_ns(raw: bytes) -> int:
    """Return the time of a Clock message [ns].

    Raises
    ------
    CdrError
        The bytes are no message, or the time is before all time.
    """
    found = CdrReader(raw).stamp_ns()
    if found < 0:
        raise CdrError(f'clock must be >= 0 s, got {1e-9 * found:g}')
    return found


class TickProgress:
    """Publishes `~/_time` of a node in simulated time, for who waits for it.

    The message (UInt64MultiArray) has two numbers: the time [ns] before which nothing more will
    leave the node, which is that of its next tick; and how many commands it has sent.

    Parameters
    ----------
    node : DenocNode
    """

    def __init__(self, node: Any) -> None:
        self._clock = node.clock
        message = UInt64MultiArray(data=[0, 0])
        message.layout.dim = [MultiArrayDimension(label='until_ns,commands', size=2, stride=2)]
        self._front = exact_bytes(message)[: -VALUES.size]
        self._publisher = node.create_publisher(UInt64MultiArray, f'~/{PROGRESS_TOPIC}', PROGRESS)
        self._listeners = listeners(self._publisher)
        self._publish = raw_publish(self._publisher)

    def tell(self, until: float, commands: int = 0) -> None:
        """Tell that all has left that belongs to moments before `until` [s]; infinite: ever."""
        if self._listeners():
            until_ns = FOREVER if until == math.inf else max(0, self._clock.stamp_ns(until))
            self._publish(self._front + VALUES.pack(until_ns, commands))


class Partner:
    """A node that time waits for.

    Attributes
    ----------
    name : str
    until_ns : int or None
        The time [ns] before which nothing more leaves it; None before it has said so.
    commands : int
        How many commands it has sent.
    heard : float
        When it said something last, steady clock [s].
    """

    def __init__(self, node: Any, name: str) -> None:
        self.name = name
        self.until_ns: int | None = None
        self.commands = 0
        self.heard = time.perf_counter()
        topic = f'{name}/{PROGRESS_TOPIC}'
        self.subscription = subscribe_aside(node, UInt64MultiArray, topic, BEST_EFFORT)

    def take(self) -> None:
        """Take its waiting messages."""
        for raw, *_ in arrived(self.subscription, PROGRESS.depth):
            self.until_ns, self.commands = VALUES.unpack_from(raw, len(raw) - VALUES.size)
            self.heard = time.perf_counter()


class Lockstep:
    """The partners of who makes the time: it goes on when all have answered.

    Parameters
    ----------
    node : DenocNode
    names : sequence of str
        Of the partners.
    patience : float
        s of wall time that a partner may take to say a word, once it has said one.
    """

    def __init__(self, node: Any, names: Sequence[str], patience: float) -> None:
        self.partners = [Partner(node, name) for name in names]
        self._patience = patience
        self._waits = WaitSet(node.context, [each.subscription for each in self.partners])
        self._since = time.perf_counter()
        self._asked_ns = -1
        self._looks = 0

    def answered(self, now_ns: int) -> bool:
        """Say whether nothing more will leave the partners for a time [ns]; may wait a moment."""
        if now_ns != self._asked_ns:
            self._asked_ns, self._since, self._looks = now_ns, time.perf_counter(), 0
        begin = time.perf_counter()
        while True:
            for each in self.partners:  # all: what waits in a queue would end each wait at once
                each.take()
            if not self.awaited(now_ns):
                return True
            left = LOOK - (time.perf_counter() - begin)
            if left <= 0.0:
                self._looks += 1
                return False
            self._waits.wait(left)

    def awaited(self, now_ns: int | None = None) -> list[Partner]:
        """Return the partners whose answer to a time [ns] is missing; by default the last one."""
        asked = self._asked_ns if now_ns is None else now_ns
        return [each for each in self.partners if each.until_ns is None or each.until_ns <= asked]

    @property
    def waited(self) -> float:
        """For how long the last time has been asked for [s]."""
        return time.perf_counter() - self._since

    def late(self) -> str:
        """Return which partner, that once answered, is silent for too long; '' if none is."""
        now = time.perf_counter()
        # counted: after this process or the whole machine stood still, nobody can have answered
        if self._looks * LOOK < 0.5 * self._patience:
            return ''
        for each in self.awaited():
            silence = now - max(each.heard, self._since)
            if each.until_ns is not None and silence > self._patience:
                return (
                    f'lockstep: {each.name} must answer within {self._patience:g} s, got nothing '
                    f'for {silence:.1f} s at simulated time {1e-9 * self._asked_ns:.6f} s'
                )
        return ''


class TimeSource:
    """The time that a node makes for others.

    Before each step it waits, in lockstep, until each partner has told on `<partner>/_time` that
    all has left which belongs to the present moment, and until the commands that they have counted
    have come: the middleware keeps no order between topics.

    Parameters
    ----------
    node : Node
        It publishes and listens.
    partners : sequence of str
        Nodes that each step waits for; none: it waits for nobody.
    patience : float
        s of wall time that a partner may take to say a word, once it has said one.
    standing : callable
        Called now and then while time stands.
    start_ns : int
        Where time begins [ns].

    Attributes
    ----------
    clock : SourceClock
    commands : Input or None
        Those that are counted.
    trouble : str
        Why the run must end, '' while it may go on.
    """

    def __init__(
        self,
        node: Any,
        partners: Sequence[str] = (),
        patience: float = math.inf,
        standing: Callable[[], None] = lambda: None,
        start_ns: int = 0,
    ) -> None:
        self._ros_clock = node.get_clock() if release_clock(node) else None
        self._publish = raw_publish(node.create_publisher(Clock, CLOCK_TOPIC, EVERY_MESSAGE))
        self._message = bytearray(exact_bytes(Clock(clock=TimeMessage())))
        self._lockstep = Lockstep(node, partners, patience) if partners else None
        self.clock = SourceClock(self._tell, self.may_leave, standing, start_ns)
        self.commands: Input | None = None
        self.trouble = ''
        self._lost = self._lost_told = 0
        self._reported = time.perf_counter(), start_ns

    def _tell(self, now_ns: int) -> None:
        STAMP.pack_into(self._message, 4, *stamp_fields(now_ns))
        self._publish(bytes(self._message))
        if self._ros_clock is not None:
            self._ros_clock.set_ros_time_override(Time(nanoseconds=now_ns, clock_type=ROS_TIME))

    def may_leave(self, now_ns: int) -> bool:
        """Say whether the partners have answered a time [ns]; may wait a moment."""
        lockstep = self._lockstep
        if lockstep is None:
            return True
        if self.trouble:
            time.sleep(LOOK)
            return False
        if not lockstep.answered(now_ns):
            self.trouble = lockstep.late()
            return False
        return self._commands_came(max(each.commands for each in lockstep.partners))

    def _commands_came(self, counted: int) -> bool:
        """Say whether as many commands have come as their sender has counted."""
        commands = self.commands
        if commands is None:
            return True
        begin = time.perf_counter()
        commands.take()
        while commands.number is not None and commands.number < counted:
            if time.perf_counter() - begin > LOST:
                self._lost += counted - commands.number
                commands.number = counted
                break
            time.sleep(1e-4)
            commands.take()
        return True

    def awaited(self) -> list[str]:
        """Return the partners that have not answered the present moment."""
        lockstep = self._lockstep
        return [] if lockstep is None else [each.name for each in lockstep.awaited()]

    def status(self) -> Status:
        """Return the time, how fast it goes, and whom it waits for."""
        wall, now_ns = time.perf_counter(), self.clock.now_ns()
        (before, before_ns), self._reported = self._reported, (wall, now_ns)
        names = ', '.join(self.awaited())
        status = Status('clock', message='paused' if self.clock.paused else 'going')
        status.values = {
            'time_s': 1e-9 * now_ns,
            'factor': 1e-9 * (now_ns - before_ns) / max(wall - before, 1e-3),
            'paused': self.clock.paused,
            'waits_for': names,
            'lost_commands': self._lost,
        }
        if self._lockstep is not None and not self.clock.paused:
            new = [each.name for each in self._lockstep.awaited() if each.until_ns is None]
            if new:
                status.worsen(WARN, f'waits for the first word of {", ".join(new)}')
            elif names and self._lockstep.waited > SLOW:
                status.worsen(WARN, f'waits for {names} for {self._lockstep.waited:.1f} s')
        if self._lost > self._lost_told:
            status.worsen(WARN, f'{self._lost - self._lost_told} commands lost')
        self._lost_told = self._lost
        if self.trouble:
            status.worsen(ERROR, self.trouble)
        return status
