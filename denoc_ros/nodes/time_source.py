"""The plant as a source of time: /clock, a pace, pauses, and partners that it waits for."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from typing import Any

from builtin_interfaces.msg import Time as TimeMessage
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.time import Time
from rosgraph_msgs.msg import Clock
from std_msgs.msg import UInt64MultiArray

from denoc_ros.bags.cdr import stamp_fields
from denoc_ros.nodes.base import EVERY_MESSAGE
from denoc_ros.nodes.clock_input import ROS_TIME, TOPIC, WaitSet, release_clock
from denoc_ros.nodes.inputs import Input, arrived, subscribe_aside
from denoc_ros.nodes.messages import STAMP, exact_bytes, raw_publish
from denoc_ros.nodes.progress import PROGRESS, VALUES
from denoc_ros.nodes.progress import TOPIC as PROGRESS_TOPIC
from denoc_ros.runtime.clocks import SourceClock
from denoc_ros.runtime.status import ERROR, WARN, Status

LOOK = 0.02  # s of wall time at most for one look for answers
LOST = 0.5  # s of wall time that a command may take that its sender has counted
SLOW = 1.0  # s of wall time for an answer after which the status names who owes it
BEST_EFFORT = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)


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
        self._publish = raw_publish(node.create_publisher(Clock, TOPIC, EVERY_MESSAGE))
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
