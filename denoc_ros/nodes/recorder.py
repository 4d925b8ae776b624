"""The recorder: topics into MCAP files that survive a kill, a slow and a full disk."""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from operator import attrgetter, itemgetter
from pathlib import Path
from typing import Any

from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import String

from denoc_ros.bags.background import BackgroundWriter, WriterStatus
from denoc_ros.bags.definitions import encode
from denoc_ros.bags.metadata import Qos
from denoc_ros.bags.writer import BagWriter
from denoc_ros.errors import BagError
from denoc_ros.model.reading.source import complete_text
from denoc_ros.nodes.base.denoc_node import DenocNode
from denoc_ros.nodes.base.inputs import arrived, subscribe_aside
from denoc_ros.nodes.base.messages import LATCHED, message_class
from denoc_ros.nodes.base.process import leave, run
from denoc_ros.nodes.base.simulated_time import CLOCK_TOPIC, ClockInput, TickProgress
from denoc_ros.runtime.inputs.input_monitor import Gaps
from denoc_ros.runtime.loop.realtime import make_process_timely
from denoc_ros.runtime.loop.status import ERROR, OK, WARN, Status
from denoc_ros.runtime.parameters.recorder_parameters import TABLE

DESCRIPTION_ATTACHMENT = 'robot_description.urdf'
MARK_TYPE = 'std_msgs/msg/String'
QUEUE_DEPTH = 5000
# s between looks into the queues: a callback for each message would cost several times as much
TAKE_PERIOD = 0.005
LOOK_PERIOD = 0.05  # s between looks at the graph: what is published before one is not recorded
LOOKS_PER_CHECK = 20  # looks between checks of the offered QoS
LONGEST_HELD = 500_000_000  # ns of wall time that a message waits for the next of the clock
AHEAD = 0.05  # s of simulated time that the queues hold of what has not been taken yet
ONE_TYPE = '{}: topic must have one type at a time, {}, got also {}'
TRANSPORT = 'transport'  # lost before the recorder had them
STALL_PERIODS = 5.0  # flush periods without progress of the writing thread that make a stall


# log time [ns], topic, message, when it was sent [ns]
Taken = tuple[int, str, bytes, int]


@dataclass
class Recorded:
    """A recorded topic, and its publishers' offers."""

    type: str
    qos: QoSProfile
    subscription: Any
    gaps: Gaps


class Recorder(DenocNode):
    """Records while active; `~/start`, `~/stop`, `~/split`, `~/mark` act within that."""

    clock_depth = QUEUE_DEPTH
    prioritized = staticmethod(make_process_timely)

    def __init__(self, **options: Any) -> None:
        super().__init__('recorder', TABLE, **options)
        self.writer: BackgroundWriter | None = None
        self.progress = TickProgress(self) if self.clock.is_simulated else None
        self.description = ''
        self._topics: dict[str, Recorded] = {}
        self._held: list[Taken] = []
        self._last_clock = b''
        # types that are offered and not recorded, by topic
        self._refused: dict[str, set[str]] = {}
        self._changed: Counter[str] = Counter()  # how often a topic went on with another type
        self._news: list[str] = []  # what the next status warns of
        self._missed: Counter[str] = Counter()
        self._looks = 0
        self._recordings: Counter[str] = Counter()  # by output
        self._marks = 0
        self._told_lost = self._told_files = 0
        self._told_failure = False
        self._mark_topic = f'{self.get_fully_qualified_name()}/marks'
        self.create_timer(LOOK_PERIOD, self._look, clock=self.steady_clock)
        self.create_timer(TAKE_PERIOD, self._take, clock=self.steady_clock)
        self.create_subscription(String, 'robot_description', self._on_description, LATCHED)
        for name in ('start', 'stop', 'split', 'mark'):
            self.add_trigger_service(f'~/{name}', getattr(self, name))

    # ---- lifecycle

    def configure(self) -> None:
        """Read the robot to attach."""
        if path := self.settings.text('urdf_path'):
            self.description = complete_text(path)

    def activate(self) -> None:
        """Begin to record; the threads then get their priority as in every node."""
        self._begin()

    def deactivate(self) -> None:
        """Finish the bag."""
        if self.writer is not None:
            self.stop()
        self._tell_progress(math.inf)

    # ---- services

    def start(self) -> str:
        """Begin a new bag, with the priority of an active node for its writing thread."""
        begun = self._begin()
        if self.owns_process:
            self.realtime_options.update(
                self.prioritized(self.settings.integer('thread_priority'))
            )
        return begun

    def _begin(self) -> str:
        """Begin a new bag; return where."""
        if self.writer is not None:
            raise BagError(
                f'{self.writer.path}: recording must be stopped before a new one starts'
            )
        settings = self.settings
        bag = BagWriter(
            self._next_path(),
            settings.text('compression'),
            settings.integer('max_bag_size'),
            settings.number('max_bag_duration'),
        )
        self._recordings[settings.text('output')] += 1
        self._marks = self._told_lost = self._told_files = 0
        self._told_failure = False
        self._refused.clear()
        self._changed.clear()
        self._news.clear()
        self._missed.clear()
        self.writer = BackgroundWriter(
            bag,
            settings.integer('queue_size'),
            settings.number('flush_period'),
            settings.integer('min_free_space'),
            queue_bytes=settings.integer('queue_bytes'),
        )
        if self.description:
            self.writer.attach(DESCRIPTION_ATTACHMENT, self.description, self.stamp_ns())
        self._looks = 0
        self._look()
        self.get_logger().info(f'recording to {bag.path}')
        return f'recording to {bag.path}'

    def stop(self) -> str:
        """Finish the bag; return its content in words."""
        writer = self._recording()
        self._take(last=True)
        self.writer = None
        for recorded in self._topics.values():
            self.drop(recorded.subscription)
        count = len(self._topics)
        self._topics.clear()
        status = writer.close()
        self._tell_files(status)
        lost = self._lost(status)
        message = (
            f'{writer.path}: {status.written} messages on {count} topics, '
            f'{sum(lost.values())} lost'
        )
        if lost:
            message += ' (' + ', '.join(f'{topic} {lost[topic]}' for topic in sorted(lost)) + ')'
        if status.failure:
            raise BagError(f'{message}; {status.failure}')
        # two calls: rclpy refuses a line of code that changes its severity
        if lost:
            self.get_logger().warning(message)
        else:
            self.get_logger().info(message)
        return message

    def save(self) -> None:
        """Finish the bag with the messages so far, though the executor hangs."""
        if self.writer is not None:
            self.writer.close()

    def split(self) -> str:
        """Go on in a new file."""
        self._recording().split()
        return 'next file'

    def mark(self) -> str:
        """Put a numbered mark into the bag, on `~/marks`."""
        writer = self._recording()
        if not self._marks:
            writer.add_topic(self._mark_topic, MARK_TYPE)
        self._marks += 1
        text = f'mark {self._marks}'
        stamp = self.stamp_ns()
        writer.put(self._mark_topic, stamp, encode(MARK_TYPE, stamp, {'data': text}))
        return text

    def _recording(self) -> BackgroundWriter:
        if self.writer is None:
            raise BagError(
                f'{self.get_fully_qualified_name()}: must be recording, got a stopped one'
            )
        return self.writer

    def _next_path(self) -> Path:
        output = self.settings.text('output')
        path = Path(output or time.strftime('recording_%Y%m%d_%H%M%S'))
        before = self._recordings[output]
        return path.with_name(f'{path.name}_{before + 1}') if before else path

    # ---- topics

    def _on_description(self, message: String) -> None:
        if message.data == self.description or self.settings.text('urdf_path'):
            return
        self.description = message.data
        if self.writer is not None:
            self.writer.attach(DESCRIPTION_ATTACHMENT, self.description, self.stamp_ns())

    def _look(self) -> None:
        """Subscribe to new topics on the graph; check offers now and then."""
        if self.writer is None:
            return
        self._tell_files(self.writer.status())
        check = self._looks % LOOKS_PER_CHECK == 0
        if check and self.clock_input is not None:
            self.clock_input.miss_nothing()
        self._looks += 1
        for topic, types in self.get_topic_names_and_types():
            recorded = self._topics.get(topic)
            if recorded is None:
                if (check or topic not in self._refused) and self._wanted(topic):
                    self._add(topic, Gaps())
            elif check or types != [recorded.type]:
                self._check_offer(topic, recorded)

    def _wanted(self, topic: str) -> bool:
        patterns = self.settings.texts('topics')
        if not patterns:
            return not any(part.startswith('_') for part in topic.split('/'))
        return any(fnmatchcase(topic, f'/{pattern.lstrip("/")}') for pattern in patterns)

    def _add(self, topic: str, gaps: Gaps) -> None:
        """Record a topic by the first of its types that is installed."""
        for name, offers in by_type(self.get_publishers_info_by_topic(topic)).items():
            if name in self._refused.get(topic, ()):
                continue
            try:
                message_type = message_class(name)
                self._recording().add_topic(topic, name, offered(offers))
            except BagError as error:
                self._refuse(topic, name, str(error))
                continue
            self._subscribe(topic, name, message_type, matching(offers), gaps)
            return

    def _check_offer(self, topic: str, recorded: Recorded) -> None:
        """Subscribe by what the publishers of a topic offer now.

        The middleware gives a process one type of a topic at a time. The recorded one stays until
        nobody publishes it.
        """
        offers = by_type(self.get_publishers_info_by_topic(topic))
        own = offers.pop(recorded.type, None)
        if own is None:
            if offers:
                self._change_type(topic, recorded, next(iter(offers)))
            return
        for name in offers:
            self._refuse(topic, name, ONE_TYPE.format(topic, recorded.type, name))
        if same(matching(own), recorded.qos):
            return
        self.get_logger().warning(f'{topic}: offered QoS changed, subscribing anew')
        self._take()
        self.drop(recorded.subscription)
        kind = message_class(recorded.type)
        self._subscribe(topic, recorded.type, kind, matching(own), recorded.gaps)

    def _change_type(self, topic: str, recorded: Recorded, name: str) -> None:
        """Go on with another type of a topic, whose messages so far are in the bag by then."""
        self._take(last=True)
        self.drop(recorded.subscription)
        del self._topics[topic]
        self._refused.pop(topic, None)
        self._changed[topic] += 1
        self._warn(f'{topic}: type changed from {recorded.type} to {name}')
        # What was sent of the other type while this one was recorded is lost.
        self._add(topic, Gaps(0))

    def _refuse(self, topic: str, name: str, why: str) -> None:
        """Say once why messages of a type are not recorded."""
        refused = self._refused.setdefault(topic, set())
        if name not in refused:
            refused.add(name)
            self._warn(f'not recorded: {why}')

    def _warn(self, text: str) -> None:
        self.get_logger().warning(text)
        self._news.append(text)

    def _subscribe(
        self, topic: str, name: str, message_type: type, qos: QoSProfile, gaps: Gaps
    ) -> None:
        subscription = subscribe_aside(self, message_type, topic, qos)
        self._topics[topic] = Recorded(name, qos, subscription, gaps)

    def _take(self, last: bool = False) -> None:
        """Put the messages since the last call into the bag, topics in the order of time."""
        writer = self.writer
        if writer is None:
            if self.state == 'active':  # and stopped
                self._tell_progress(math.inf)
            return
        taken = []
        for topic, recorded in self._topics.items():
            waiting = list(arrived(recorded.subscription, QUEUE_DEPTH))
            if not waiting:
                continue
            publishers = recorded.subscription.handle.get_publisher_count()
            for raw, received_ns, sent_ns, number in waiting:
                if missed := recorded.gaps.missed(number, publishers):
                    self._missed[topic] += missed
                taken.append((received_ns, topic, raw, sent_ns))
        if self.clock_input is not None:
            taken = self._in_simulated_time(self.clock_input, taken, last)
        else:
            now_ns = self.stamp_ns()
            taken = [(log or now_ns, topic, raw, sent or log) for log, topic, raw, sent in taken]
        taken.sort(key=itemgetter(0))
        writer.put_all(
            [
                # a bag has no time before 1970, which a publisher's clock or /clock may tell
                (topic, log_ns if log_ns > 0 else 0, raw, max(sent_ns or log_ns, 0))
                for log_ns, topic, raw, sent_ns in taken
            ]
        )
        if writer.share_queued < 0.5:
            self._tell_progress(self.clock.now() + AHEAD)

    def _in_simulated_time(self, clock: ClockInput, taken: list[Taken], last: bool) -> list[Taken]:
        """Return messages with the times that /clock showed when they were sent.

        Those that were sent after the newest message of the clock wait, unless they are the last:
        the next may have come between. A clock that repeats itself is left out.
        """
        self.follow_clock()
        known_ns, old_ns = clock.last_sent_ns, time.time_ns() - LONGEST_HELD
        held, self._held = [*self._held, *taken], []
        found = []
        for message in held:
            _, topic, raw, sent_ns = message
            if sent_ns > max(old_ns, known_ns) and not last:
                self._held.append(message)
            elif topic != CLOCK_TOPIC or raw != self._last_clock:
                shown_ns = clock.time_of(sent_ns)
                log_ns = self.stamp_ns() if shown_ns is None else shown_ns
                found.append((log_ns, topic, raw, log_ns))
                self._last_clock = raw if topic == CLOCK_TOPIC else self._last_clock
        return found

    def _tell_progress(self, until: float) -> None:
        """Tell who makes the time how far it may go before the queues are taken again."""
        if self.progress is not None:
            self.progress.tell(until)

    # ---- diagnostics

    def _tell_files(self, status: WriterStatus) -> None:
        """Say once of each file that it is no longer there."""
        for loss in status.losses[self._told_files :]:
            self.get_logger().error(str(loss))
        self._told_files = len(status.losses)

    def _lost(self, status: WriterStatus) -> Counter[str]:
        return Counter(status.lost) + self._missed

    def statuses(self) -> list[Status]:
        """Return how the recording goes."""
        if self.writer is None:
            return [Status('recording', OK, 'stopped')]
        now = self.writer.status()
        lost = self._lost(now)
        total = sum(lost.values())
        causes = {
            **now.causes,
            **({TRANSPORT: missed} if (missed := self._missed.total()) else {}),
        }
        status = Status('recording', OK, f'recording to {self.writer.path}')
        status.values = {
            'path': self.writer.path,
            'topics': len(self._topics),
            'written': now.written,
            'queued': now.queued,
            'queued_bytes': now.queued_bytes,
            'lost': total,
            'stalled_s': now.stalled,
            'files_lost': len(now.losses),
            'types_changed': self._changed.total(),
            'types_refused': sum(map(len, self._refused.values())),
            **{f'lost {topic}': count for topic, count in sorted(lost.items())},
            **{f'lost by {cause}': count for cause, count in sorted(causes.items())},
        }
        for text in self._news:
            status.worsen(WARN, text)
        self._news.clear()
        if now.losses:
            status.worsen(WARN, str(now.losses[-1]))
        if total > self._told_lost:
            status.worsen(WARN, f'{total - self._told_lost} messages lost')
            self.get_logger().warning(f'{total - self._told_lost} messages lost')
        self._told_lost = total
        if now.stalled > STALL_PERIODS * self.settings.number('flush_period'):
            status.worsen(WARN, f'disk stalled for {now.stalled:.1f} s')
        if now.failure:
            status.worsen(ERROR, now.failure)
            if not self._told_failure:
                self.get_logger().error(now.failure)
            self._told_failure = True
        return [status]


def matching(offers: Sequence[Any]) -> QoSProfile:
    """Return the strictest request that all publishers of a topic meet."""
    profiles = [offer.qos_profile for offer in offers]
    reliable = all(each.reliability == ReliabilityPolicy.RELIABLE for each in profiles)
    latched = all(each.durability == DurabilityPolicy.TRANSIENT_LOCAL for each in profiles)
    return QoSProfile(
        depth=QUEUE_DEPTH,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


def by_type(offers: Sequence[Any]) -> dict[str, list[Any]]:
    """Return the offers of a topic's publishers by the type of their messages."""
    found: dict[str, list[Any]] = {}
    for offer in sorted(offers, key=attrgetter('topic_type')):
        found.setdefault(offer.topic_type, []).append(offer)
    return found


def same(one: QoSProfile, other: QoSProfile) -> bool:
    """Say whether two requests ask for the same reliability and durability."""
    return bool(one.reliability == other.reliability and one.durability == other.durability)


def offered(offers: Sequence[Any]) -> tuple[Qos, ...]:
    """Offered profiles of the publishers, each once, in the bag's form."""
    profiles = [offer.qos_profile for offer in offers]
    rows = [
        Qos(
            history=int(each.history),
            depth=int(each.depth),
            reliability=int(each.reliability),
            durability=int(each.durability),
            liveliness=int(each.liveliness),
        )
        for each in profiles
    ]
    return tuple(dict.fromkeys(rows))


def main() -> None:
    """Run the recorder as a process."""
    leave(run(Recorder, shared_memory=True))


if __name__ == '__main__':
    main()
