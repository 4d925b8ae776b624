"""The witness of a siege: takes what leaves as torque, judges pauses by the system's absence."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from trust.laws import OPEN, PERIODS, TIMER, Life, Span, Spans, TorqueLedger, unexplained
from trust.sieges.siege_scenes import Scene

DEEP = QoSProfile(depth=5000, reliability=ReliabilityPolicy.RELIABLE)
NEAR = 1e-6  # rad, m from the goal
FRESH = 0.2  # s
BEHIND = 1_200_000_000  # ns that the meters may be behind their own newest line
METERS = 20.0  # s that a meter may be away at the end
LONG_PAST = 60_000_000_000  # ns


class Witness:
    """Holds what the feedforward publishes to the laws.

    Parameters
    ----------
    scene : Scene
    folder : Path
        Where `bare` and `meter` are (see `trust.absence`).
    slack : float
        s that torque may pause beyond the law.
    relay : callable
        Is given every command.

    Attributes
    ----------
    efforts, commands : TorqueLedger
    lives : dict of int to Life
        By process id.
    pauses : list of (float, float, float)
        Each pause over two periods: its length, the absence of the bare node or of the
        feedforward's own threads meanwhile, and of all threads of all nodes, s.
    """

    def __init__(
        self, scene: Scene, folder: Path, slack: float, relay: Callable[[Any], None]
    ) -> None:
        self._goal, self._folder, self._slack, self._relay = scene.goal, folder, slack, relay
        limits = np.array(scene.limits)
        self.efforts, self.commands = (
            TorqueLedger(limits, scene.delta, scene.rate) for _ in range(2)
        )
        self._most = PERIODS / scene.rate  # s between torques
        self._is_simulated = scene.factor > 0.0
        self.efforts.lull = scene.lull
        self.lives: dict[int, Life] = {}
        self.pauses: list[tuple[float, float, float]] = []
        self._excused: list[Span] = []
        self._waits: list[tuple[Span, str, float]] = []
        self._bare: list[Span] = []
        self._offsets: dict[str, int] = {}
        self._measured = {'bare': 0, 'meter': 0}  # ns up to which each has spoken
        self._position = np.empty(0)
        self._at = 0.0
        self._tick_ns = 0
        self._lock = threading.Lock()
        # no executor serves it: what is taken by hand has the time it left and its number
        self.node = Node('witness', use_global_arguments=False)
        self._effort, self._command = (
            self.node.create_subscription(
                kind, f'/feedforward/{topic}', lambda _: None, DEEP, raw=True
            )
            for kind, topic in ((JointState, 'effort'), (Float64MultiArray, 'commands'))
        )
        self.node.create_subscription(JointState, '/bare/effort', lambda _: None, DEEP)

    def look(self) -> None:
        """Take what has left."""
        with self._lock:
            for message, sent_ns, number in taken(self._effort):
                self._at = time.perf_counter()
                self._position = np.array(message.position)
                self._tick_ns = stamp_of(message) if self._is_simulated else 0
                self.efforts.take(sent_ns, number, np.array(message.effort), self._tick_ns)
            for message, sent_ns, number in taken(self._command):
                self._relay(message)
                self.commands.take(sent_ns, number, np.array(message.data))

    def following(self, now_ns: int) -> bool:
        """Say whether the newest torque is fresh and along the reference.

        In simulated time it is for now [ns] as well: a clock that was set may take seconds to be
        caught up with.
        """
        position = self._position
        is_for_now = not self._is_simulated or abs(self._tick_ns - now_ns) < 1e9 * FRESH
        return (
            is_for_now
            and time.perf_counter() - self._at < FRESH
            and position.shape == (len(self._goal),)
            and bool(np.abs(position - self._goal).max() < NEAR)
        )

    def excuse(self, begin: int | None = None, end: int = OPEN) -> None:
        """Let the feedforward be silent from then [ns] until another time, or :meth:`settle`."""
        self._excused.append(Span(time.time_ns() if begin is None else begin, end))

    def excuse_anew(self, begin: int | None = None) -> None:
        """Let it be silent, and its torque begin anew, from then until :meth:`settle`."""
        self.excuse(begin)
        for ledger in (self.efforts, self.commands):
            ledger.anew.append(self._excused[-1])

    def excuse_clock(self) -> None:
        """Let simulated time jump from now until :meth:`settle`."""
        self.efforts.clock_set.append(Span(time.time_ns()))

    def await_clock(self, begin: int, end: int, period: float) -> None:
        """Count time [ns] without a clock message, beyond its period [s], as absence."""
        if (late := 1e-9 * (end - begin) - period) > TIMER:
            with self._lock:
                self._waits.append((Span(begin, end), 'clock', late))

    def settle(self) -> None:
        """Say that all is as before; forget what is long past."""
        now = time.time_ns()
        for span in [*self._excused, *self.efforts.clock_set]:
            span.end = min(span.end, now)
        # mending may take minutes: a pause that is yet to be judged takes what was then
        past = min([now - LONG_PAST, *(pause.begin for pause in self.efforts.pauses)])
        anew = self.efforts.anew, self.commands.anew, self.efforts.clock_set
        for spans in (self._excused, *anew, self._bare):
            spans[:] = [span for span in spans if span.end > past]
        with self._lock:
            self._waits = [wait for wait in self._waits if wait[0].end > past]

    def judge(self, final: bool = False) -> list[str]:
        """Return the laws that were broken since the last call."""
        self.look()
        self._read()
        self.commands.pauses.clear()  # those of efforts, once more
        commands = [f'commands: {law}' for law in self.commands.told()]
        return [*self.efforts.told(), *commands, *self._judge_pauses(final)]

    def _judge_pauses(self, final: bool) -> list[str]:
        """Return the pauses that the system does not explain, once its absence is known."""
        if final:
            self._await_meters()
        known = OPEN if final else min(self._measured.values()) - BEHIND
        pending, broken = self.efforts.pauses, []
        self.efforts.pauses = [pause for pause in pending if pause.end > known]
        if len(self.efforts.pauses) == len(pending):
            return []
        with self._lock:
            waits = list(self._waits)
        excused, bare, waiting = map(Spans, (self._excused, self._bare, [w[0] for w in waits]))
        seconds = bare.seconds
        late = np.array([late for _, _, late in waits])
        is_own = np.array([name == 'feedforward' for _, name, _ in waits], dtype=np.bool_)
        for pause in pending:
            if pause.end > known or excused.meet(pause).any():
                continue
            longest = seconds[bare.meet(pause)].max(initial=0.0)
            meanwhile = waiting.meet(pause)
            own = max(longest, late[meanwhile & is_own].sum())
            every = max(longest, late[meanwhile].sum())
            self.pauses.append((pause.seconds, own, every))
            allowed = self._most + self.efforts.lull + self._slack
            if unexplained(pause, allowed, every):
                broken.append(
                    f'feedforward: torque must not pause over {PERIODS:g} periods beyond the '
                    f"system's own absence, got {1e3 * pause.seconds:.1f} ms at {pause.begin} "
                    f'(absence {1e3 * every:.1f} ms)'
                )
        return broken

    def _await_meters(self) -> None:
        """Wait until they have spoken of all that has been until now."""
        now, end = time.time_ns() + BEHIND, time.monotonic() + METERS
        while min(self._measured.values()) < now and time.monotonic() < end:
            time.sleep(0.1)
            self._read()

    def pauses_told(self) -> dict[str, float]:
        """Return how many pauses there were, the longest, and how many were whose [ms]."""
        longest, own, every = max(self.pauses, default=(0.0, 0.0, 0.0))
        beyond = [p for p in self.pauses if p[0] > self._most + p[1] + 5e-4]
        return {
            'number': len(self.pauses),
            'longest_ms': 1e3 * longest,
            'bare_or_own_threads_away_meanwhile_ms': 1e3 * own,
            'all_nodes_threads_away_meanwhile_ms': 1e3 * every,
            'longer_than_bare_or_own_absence': len(beyond),
        }

    def _read(self) -> None:
        """Take in what the two processes beside the stage have measured."""
        for line in self._new_lines('bare'):
            begin, end = map(int, line.split())
            self._bare.append(Span(begin, end))
            self._measured['bare'] = end
        for line in self._new_lines('meter'):
            kind, *rest = line.split()
            if kind == 'w':
                self._waits.append((Span(int(rest[0]), int(rest[1])), rest[2], float(rest[3])))
                continue
            self._measured['meter'] = round(1e9 * float(rest[0]))
            life = self.lives.setdefault(int(rest[2]), Life(rest[1], int(rest[2])))
            life.at.append(float(rest[0]))
            life.memory.append(float(rest[3]))
            life.files.append(int(rest[4]))

    def _new_lines(self, name: str) -> list[str]:
        path = self._folder / name
        if not path.exists():
            return []
        with path.open() as file:
            file.seek(self._offsets.get(name, 0))
            text = file.read()
        whole = text[: text.rfind('\n') + 1]
        self._offsets[name] = self._offsets.get(name, 0) + len(whole)
        return whole.splitlines()


def stamp_of(message: Any) -> int:
    """Return the stamp of a message's header [ns]."""
    stamp = message.header.stamp
    return int(stamp.sec * 1_000_000_000 + stamp.nanosec)


def taken(subscription: Any) -> Any:
    """Yield (message, when it left [ns], its number) of all that waits."""
    take, kind = subscription.handle.take_message, subscription.msg_type
    while (found := take(kind, True)) is not None:
        raw, info = found
        number = info['publication_sequence_number']
        yield deserialize_message(raw, kind), info['source_timestamp'], number
