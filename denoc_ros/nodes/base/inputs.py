"""One input topic of a node: raw messages, checked, handed on, refused and counted."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from time import perf_counter, thread_time, time_ns
from typing import Any, Protocol

from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory

from denoc_ros.bags.cdr import CdrError, CdrReader
from denoc_ros.bags.joint_state import read_names
from denoc_ros.runtime.inputs.input_monitor import (
    MOST_JOINTS,
    ActivePublishers,
    InputError,
    InputMonitor,
)
from denoc_ros.runtime.loop.clocks import Clock

HELD = 4  # heavy messages that wait; more of them in so short a time are a flood
# s of a processor for the messages of one take after the first of them; then the newest only
TAKE_TIME = 2e-3
AWAY = 0.01  # s since the last take after which the process is taken to have stood still
HEAVY_TIME = 0.01  # s at a time for heavy messages, or one of them
HEAVY_SHARE = 0.25  # of the time, so that services and timers are served in a flood
# ns that a stamp of the simulated clock may be before, or ahead of, the clock when it comes
SAME_CLOCK = 1_000_000_000
POINT = ('positions', 'velocities', 'accelerations', 'effort')  # of a JointTrajectoryPoint
COUNTED = 5e-3  # s between counts of the publishers while nothing comes
NONE = -1  # number of no message
EVEN = 1000  # ns by which intervals of a regular input differ
# raw message, and when it arrived on the robot's clock [s]
Handler = Callable[[bytes, float], None]


def never_heavy(_raw: bytes) -> bool:
    """Say that a loop has time for every message."""
    return False


def subscribe_aside(node: Any, message_type: type, topic: str, qos: QoSProfile) -> Any:
    """Subscribe to raw messages that no executor serves: :func:`arrived` yields them."""
    subscription = node.create_subscription(message_type, topic, _never, qos, raw=True)
    node.take_aside(subscription)
    return subscription


def _never(_raw: bytes) -> None:
    """Stand for the callback of a subscription that no executor serves."""


def arrived(subscription: Any, depth: int) -> Iterator[tuple[bytes, int, int, int | None]]:
    """Yield the waiting messages of a subscription that no executor serves.

    Parameters
    ----------
    subscription : rclpy Subscription
    depth : int
        Of its queue: no more than that, as publishers go on meanwhile.

    Yields
    ------
    raw : bytes
    received_ns, sent_ns : int
        When, by the system's clock; 0 where the middleware does not say.
    number : int or None
        Of its publisher's messages, from 1 on; None where the middleware does not number them.
    """
    for raw, info in _taken(subscription.handle.take_message, subscription.msg_type, depth):
        number = info['publication_sequence_number']
        yield raw, info['received_timestamp'], info['source_timestamp'], number


def arrivals(infos: Sequence[Mapping[str, int]], before: float) -> list[float]:
    """Return when messages came, on the steady clock [s].

    Parameters
    ----------
    infos : sequence of mapping
        What the middleware says of each, the oldest first.
    before : float
        When the queue was last empty, steady clock [s].
    """
    now, wall_ns = perf_counter(), time_ns()
    moments = [now - 1e-9 * (wall_ns - info['received_timestamp']) for info in infos]
    if now - before > AWAY:
        # a process that stands still receives nothing: the sender's clock has the distances
        newest, last = infos[-1]['source_timestamp'], moments[-1]
        for place, info in enumerate(infos):
            sent = last - 1e-9 * (newest - info['source_timestamp'])
            moments[place] = min(moments[place], sent)
    # whatever a wall clock was set to: they have come since the queue was last empty
    return [min(max(moment, before), now) for moment in moments]


def _taken(take: Callable[..., Any], kind: Any, depth: int) -> list[tuple[bytes, Any]]:
    """Take the waiting raw messages, each with the middleware's information, by `take`."""
    waiting: list[tuple[bytes, Any]] = []
    while len(waiting) < depth and (taken := take(kind, True)) is not None:
        waiting.append(taken)
    return waiting


def stamp_reader(message_type: type) -> Callable[[bytes], int]:
    """Make a reader of the simulated time from which a message counts [ns]; 0: at once.

    A streamed point counts from the first tick after its stamp: a tick at its stamp may be over
    when it comes. A whole motion has its start in it.
    """
    if message_type is JointTrajectory:
        return _point_stamp_ns
    fields = list(message_type.get_fields_and_field_types())  # type: ignore[attr-defined]
    return _header_stamp_ns if fields[0] == 'header' else lambda _raw: 0


def _point_stamp_ns(raw: bytes) -> int:
    """Return the time after the stamp of a streamed point [ns]; 0 for any other message."""
    try:
        reader = CdrReader(raw)
        stamp_ns = reader.stamp_ns()
        reader.string()
        joints = reader.count()
        for _ in range(min(joints, MOST_JOINTS)):
            reader.string()
        if joints > MOST_JOINTS or reader.count() != 1:
            return 0
        for _ in POINT:
            reader.block()
        return stamp_ns + 1 if stamp_ns > 0 and reader.stamp_ns() == 0 else 0
    except CdrError:  # who handles it will say so
        return 0


def _header_stamp_ns(raw: bytes) -> int:
    try:
        return CdrReader(raw).stamp_ns()
    except CdrError:  # who handles it will say so
        return 0


def _joints_of(raw: bytes) -> frozenset[str]:
    """Return the joints that a JointState names; none where it is malformed."""
    try:
        return frozenset(read_names(CdrReader(raw)))
    except CdrError:  # who handles it will say so
        return frozenset()


class Subscriber(Protocol):
    """Maker of the subscription, and listener to refused messages."""

    create_subscription: Callable[..., Any]
    take_aside: Callable[[Any], None]
    drop: Callable[[Any], None]
    clock: Clock

    def refuse(self, monitor: InputMonitor, error: InputError) -> None:
        """Count a bad message."""


class Input:
    """A subscription whose messages a node takes by a callback or, with `take`, in its loop.

    What would take a loop too long waits, with what comes after it, for `take_heavy` in another
    thread.

    In simulated time, which has no hurry, nothing is too long. There a message counts from its
    stamp on: one for later waits, and the moment it is handled with is that of its stamp. A
    regular input's next message is `missing` when a tick at its time begins before it has come.

    Parameters
    ----------
    node : Subscriber
    message_type : type
    topic : str
    handle : callable
        Parses and stores a message, or raises InputError.
    qos : QoSProfile
    monitor : InputMonitor
        It counts.
    is_heavy : callable
        Says of a raw message whether a loop has no time for it.

    Attributes
    ----------
    monitor : InputMonitor
        As given.
    subscription : rclpy Subscription
    missing : bool
        Whether a message is due at the moment at hand that has not come.
    number : int or None
        Of the newest message, as its publisher counts; None before the first.
    longest : float
        Bytes; what is longer and not heavy is refused before anything of it is read.
    """

    def __init__(
        self,
        node: Subscriber,
        message_type: type,
        topic: str,
        handle: Handler,
        qos: QoSProfile,
        monitor: InputMonitor,
        is_heavy: Callable[[bytes], bool] = never_heavy,
    ) -> None:
        self.monitor = monitor
        self.longest = math.inf
        self._is_heavy = is_heavy
        # the newest win: the oldest makes room
        self._heavy: deque[tuple[bytes, float, int]] = deque(maxlen=HELD)
        self._handles_heavy = False
        self._heavy_due = -math.inf
        self._node, self._handle = node, handle
        self._is_simulated = node.clock.is_simulated
        self._last_take = perf_counter()
        self._depth, self._kind = qos.depth, message_type
        self._names_joints = message_type is JointState

        def subscribed() -> Any:
            # one argument only: rclpy 7.1.6's EventsExecutor fails on messages with their info
            return node.create_subscription(message_type, topic, self._on_message, qos, raw=True)

        self._subscribed = subscribed
        self.subscription = subscribed()
        self._numbered: Any = None  # a second subscription, where messages come with numbers
        self._publishers = self.subscription.handle.get_publisher_count
        self._take_message = self.subscription.handle.take_message
        self._publishing = 0  # publishers after the last take
        self._active_publishers = ActivePublishers(monitor.max_publishers)
        self.number: int | None = None
        # the next number of the only publisher, where messages are numbered; in simulated time
        # and while there are several publishers, each message gets a closer look
        self._following, self._count_due = NONE, -math.inf
        # when the last message came that was alone, until the count of publishers knows of it
        self._only: float | None = None
        self._stamp_ns = stamp_reader(message_type)
        # from when they count [ns], whether that is by their stamps, and who sends
        self._later: deque[tuple[int, bool, bytes, int]] = deque()
        self._interval = self._last_ns = self._expected_ns = 0

    def take(self) -> None:
        """Handle all that has arrived since the last call, at most a queue."""
        before = self._last_take
        self._last_take = perf_counter()
        first = self._take_message(self._kind, True)
        if first is None:
            if self._last_take >= self._count_due:
                self._count_due = self._last_take + COUNTED
                self._publishing = self._publishers()
            if self._later:
                self._give_due()
            return
        more = None if self._depth == 1 else self._take_message(self._kind, True)
        raw, info = first
        number = info['publication_sequence_number']
        if (
            more is not None
            or number != self._following
            or (self._is_heavy is not never_heavy and self._waits(raw))
        ):
            # counted after that, and before: what waited may be from one that came or went since
            publishing, self._publishing = self._publishing, self._publishers()
            publishing = max(publishing, self._publishing)
            waiting = [first] if more is None else [first, more]
            self._take_more(self._take_message, waiting, publishing, before)
            return
        # the next one of the only publisher, as nearly every tick; moments as `arrivals` does
        self.number, self._following, self._only = number, number + 1, self._last_take
        now = perf_counter()
        came = now - 1e-9 * (time_ns() - info['received_timestamp'])
        self._give(raw, now if came > now else before if came < before else came)

    def _take_more(
        self, take: Callable[..., Any], waiting: list[Any], publishing: int, before: float
    ) -> None:
        """Handle several messages, or one that needs a closer look, and what else waits.

        Parameters
        ----------
        take : callable
            Takes a message of the subscription.
        waiting : list of (bytes, dict)
            Messages that were taken, with the middleware's information.
        publishing : int
            Publishers that may have sent them.
        before : float
            When the queue was last empty, steady clock [s].
        """
        now = self._last_take
        if self._only is not None:
            self._active_publishers.saw(self.number, self._only)
            self._only = None
        if len(waiting) > 1:
            waiting += _taken(take, self._kind, self._depth - len(waiting))
        numbers = [info['publication_sequence_number'] for _, info in waiting]
        joints: list[frozenset[str]] = []
        if self._names_joints and publishing > self.monitor.max_publishers:
            joints = [_joints_of(raw) for raw, _ in waiting]
        counts = self._active_publishers.count(publishing, numbers, now, joints)
        number = self.number = numbers[-1]
        is_alone = publishing <= self.monitor.max_publishers and not self._is_simulated
        self._following = number + 1 if is_alone and number is not None else NONE
        if self._is_simulated:
            for (raw, _), sending in zip(waiting, counts, strict=True):
                self._queue(raw, sending)
            self._give_due()
            return
        moments = arrivals([info for _, info in waiting], before)
        begin = math.inf
        messages = zip(waiting, moments, counts, strict=True)
        for place, ((raw, _), came, sending) in enumerate(messages, 1):
            if self._waits(raw):
                self._hold(raw, came, sending)
            elif place < len(waiting) and thread_time() - begin > TAKE_TIME:
                self._refuse_flood(f'messages that take less than {TAKE_TIME:g} s in all')
            else:
                self._give(raw, came, sending)
            if place == 1 and len(waiting) > 2:
                # the first that a node ever handles takes many times what others do
                begin = thread_time()

    def _waits(self, raw: bytes) -> bool:
        """Say whether a message is too long for a loop, or comes after one that is."""
        return bool(self._heavy) or self._handles_heavy or self._is_heavy(raw)

    def _queue(self, raw: bytes, sending: int) -> None:
        """Let a message wait for the simulated time from which it counts."""
        clock = self._node.clock
        stamp_ns, now_ns = self._stamp_ns(raw), clock.now_ns()
        oldest, newest = now_ns - SAME_CLOCK, clock.shown_ns + SAME_CLOCK
        stamped = stamp_ns > 0 and oldest <= stamp_ns <= newest
        self._later.append((stamp_ns if stamped else now_ns, stamped, raw, sending))
        if not stamped:
            return
        interval, self._last_ns = stamp_ns - self._last_ns, stamp_ns
        even = abs(interval - self._interval) <= EVEN
        self._interval = interval
        self._expected_ns = stamp_ns + interval if even and interval > 0 else 0

    @property
    def missing(self) -> bool:
        """Whether a regular input's message is due that has not come."""
        return 0 < self._expected_ns <= self._node.clock.now_ns() + EVEN

    def expect_nothing(self) -> None:
        """Wait for no message: it may have been lost, or nobody sends any more."""
        self._expected_ns = 0

    def forget(self) -> None:
        """Drop the waiting messages: simulated time begins anew."""
        self._later.clear()
        self._interval = self._last_ns = self._expected_ns = 0

    def _give_due(self) -> None:
        """Handle the messages that count by now."""
        later, clock = self._later, self._node.clock
        while later and later[0][0] <= clock.now_ns():
            due_ns, stamped, raw, sending = later.popleft()
            self._give(raw, clock.moment(due_ns) if stamped else clock.now(), sending)

    def _on_message(self, raw: bytes) -> None:
        """Handle a message that the executor brings, without its number."""
        publishing, now = self._publishers(), self._node.clock.now()
        if publishing <= self.monitor.max_publishers:
            if self._numbered is not None:
                self._node.drop(self._numbered)
                self._numbered = None
            self._give(raw, now, publishing)
        elif self._numbered is None:
            self._numbered = self._subscribed()
            self._node.take_aside(self._numbered)
            self._active_publishers.begin(perf_counter())
            self._give(raw, now, publishing)
        else:
            before, self._last_take = self._last_take, perf_counter()
            take, published = self._numbered.handle.take_message, self._publishing
            waiting = _taken(take, self._kind, self._depth)
            self._publishing = self._publishers()
            if waiting:
                self._take_more(take, waiting, max(published, self._publishing), before)

    def take_heavy(self) -> None:
        """Handle some of the messages that were too long for the loop, in a share of the time."""
        if not self._heavy:
            return
        begin = now = perf_counter()
        if now < self._heavy_due:
            return
        while self._heavy and now - begin < HEAVY_TIME:
            self._handles_heavy = True  # before it leaves the queue: the loop waits for its end
            self._give(*self._heavy.popleft())
            self._handles_heavy = False
            now = perf_counter()
        self._heavy_due = now + (now - begin) * (1.0 / HEAVY_SHARE - 1.0)

    def _hold(self, raw: bytes, came: float, sending: int) -> None:
        """Keep a message for `take_heavy`."""
        if len(self._heavy) == HELD:
            self._refuse_flood(f'at most {HELD} long messages at a time')
        self._heavy.append((raw, came, sending))

    def _refuse_flood(self, most: str) -> None:
        rule = f'{self.monitor.topic} must have {most}'
        self._node.refuse(self.monitor, InputError('flood', f'{rule}, got more: one is dropped'))

    def _give(self, raw: bytes, came: float, sending: int = 1) -> None:
        try:
            if sending > 1:
                self.monitor.check_publishers(sending)
            if len(raw) > self.longest:
                self._require_short(raw)
            self._handle(raw, came)
        except InputError as error:
            self._node.refuse(self.monitor, error)
        except Exception as error:  # no message may end who takes it
            cause = InputError('unexpected', f'{type(error).__name__}: {error}')
            self._node.refuse(self.monitor, cause)

    def _require_short(self, raw: bytes) -> None:
        if not self._is_heavy(raw):
            rule = f'{self.monitor.topic} must have at most {self.longest:g} bytes'
            raise InputError('too_long', f'{rule}, got {len(raw)}')
