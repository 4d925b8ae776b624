"""The viewer node: the robot's present state in the browser."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sensor_msgs.msg import JointState

from denoc_ros.nodes.base.denoc_node import DenocNode
from denoc_ros.nodes.base.guarded_node import WithoutEvents
from denoc_ros.nodes.base.inputs import Input
from denoc_ros.nodes.base.messages import NEWEST
from denoc_ros.nodes.base.process import leave, run
from denoc_ros.nodes.base.robot_node import ModelNode
from denoc_ros.runtime.inputs.input_monitor import InputMonitor
from denoc_ros.runtime.loop.rate_limiter import RateLimiter
from denoc_ros.runtime.loop.realtime import lower_priority
from denoc_ros.runtime.loop.status import WARN, Status, realtime_status
from denoc_ros.simulation.recorded.snapshot import Snapshot
from denoc_ros.viewer import NO_VISER
from denoc_ros.viewer.live_snapshots import LiveSnapshots
from denoc_ros.viewer.viewer_parameters import TABLE

if TYPE_CHECKING:
    from denoc_ros.viewer.page import Page

Admit = Callable[[int], None]
# takes a topic, as it was given, a raw message, and what admits its stamp [ns]
Taker = Callable[[str, bytes, Admit], None]
LOOK_PERIOD = 0.2  # s between looks whether anybody watches
LINGER = 2.0  # s that the inputs stay open when the last one has gone: a page that is reloaded
EXPOSED = 'the page is served beyond this machine ({}): everybody who reaches it can watch'


class _Aside(WithoutEvents):
    """A hidden node that no executor serves: its subscriptions come and go in any thread."""

    def __init__(self, owner: DenocNode) -> None:
        super().__init__(
            f'_{owner.get_name()}_inputs',
            namespace=owner.get_namespace(),
            use_global_arguments=False,
            enable_rosout=False,
            start_parameter_services=False,
        )
        self.refuse, self.clock = owner.refuse, owner.clock
        self.drop = self.destroy_subscription

    def take_aside(self, subscription: Any) -> None:
        """Do nothing: all are aside."""


class PolledInputs:
    """Subscriptions of which the newest message is taken now and then, by one thread.

    A callback for each message would take more time than all that is made of the few that are
    looked at.

    Parameters
    ----------
    node : DenocNode
        Whose inputs they are: its name space, its diagnostics.
    topics : mapping of str to type
        Message types by topic.
    take : callable
        Takes a topic, as it is given here, the raw message, and what admits its stamp [ns]; may
        raise InputError, which is counted.
    """

    def __init__(self, node: DenocNode, topics: Mapping[str, type], take: Taker) -> None:
        limit = node.settings.integer('max_publishers')
        self._owner, self._topics, self._take = node, topics, take
        self._names = {topic: node.resolve_topic_name(topic) for topic in topics}
        self._monitors = {topic: InputMonitor(self._names[topic], limit) for topic in topics}
        node.monitors.extend(self._monitors.values())
        self._inputs: dict[str, Input] = {}
        self._node = _Aside(node)

    @property
    def is_open(self) -> bool:
        """Whether there are subscriptions."""
        return bool(self._inputs)

    def listen(self, topics: Collection[str]) -> None:
        """Subscribe to topics of these inputs, and to no others any more."""
        for topic in self._inputs.keys() - set(topics):
            self._node.destroy_subscription(self._inputs.pop(topic).subscription)
        for topic in topics:
            if topic not in self._inputs:
                self._inputs[topic] = self._subscribed(topic)

    def _subscribed(self, topic: str) -> Input:
        monitor = self._monitors[topic]
        monitor.reset()

        def handle(raw: bytes, arrived: float) -> None:
            self._take(topic, raw, lambda stamp_ns: monitor.accept(stamp_ns, arrived))

        name, kind = self._names[topic], self._topics[topic]
        return Input(self._node, kind, name, handle, NEWEST, monitor)

    def shut(self) -> None:
        """Subscribe to nothing any more."""
        self.listen(())

    def forget(self) -> None:
        """Discard the last stamps: the next messages may be older."""
        for monitor in self._monitors.values():
            monitor.reset()

    def take(self) -> None:
        """Hand the newest message of each topic on, where there is a new one."""
        for each in self._inputs.values():
            each.take()

    def close(self) -> None:
        """Leave the graph, and the owner's diagnostics."""
        self.shut()
        self._node.destroy_node()
        for monitor in self._monitors.values():
            self._owner.monitors.remove(monitor)


class ViewerNode(ModelNode):
    """Draws the newest state on a page, as often as it can without disturbing others.

    While nobody watches it listens to nothing.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__('viewer', TABLE, **options)
        self.page: Page | None = None
        self.exposed = ''
        self._thread: threading.Thread | None = None
        self._stopped = threading.Event()
        self._reset_wanted = False
        self._drawn = self._drawn_reported = 0
        self._reported = time.perf_counter()
        self.add_trigger_service('~/reset', self._reset)

    # ---- configure

    def configure(self) -> None:
        """Lower the priority of the process, load the robot, serve the page."""
        if self.owns_process:
            self.realtime_options.update(lower_priority(self.settings.integer('niceness')))
        super().configure()

    def prepare(self) -> None:
        """Build the page and the readers of the topics."""
        settings, robot = self.settings, self.robot
        posture = self.posture(robot, settings)
        states = settings.texts('state_topics')
        others = settings.text('effort_topic'), settings.text('residual_topic')
        topics = [self.resolve_topic_name(name) for name in (*states, *others) if name]
        if not states or len(set(topics)) < len(topics):
            raise self.config_error(
                f"parameter 'state_topics' must name topics different from all, got {topics}"
            )
        self.snapshots = LiveSnapshots(
            robot, posture, states, *others, settings.number('timeout'), self.clock.now
        )
        self.page = self._serve()
        if robot.tree.loops:
            posture = robot.assemble(posture)
        self.page.show(Snapshot(0.0, posture))
        topics_of_type = dict.fromkeys(self.snapshots.topics, JointState)
        self.inputs = PolledInputs(self, topics_of_type, self.snapshots.take)
        self.get_logger().info(f'open {self.page.address}')
        if self.exposed:
            self.get_logger().warning(self.exposed)

    def _serve(self) -> Page:
        """Return the page, served."""
        try:
            from denoc_ros.viewer.page import LOOPBACK, Page
        except ImportError as error:
            raise self.config_error(NO_VISER.format(error)) from error
        settings = self.settings
        path, host = settings.text('urdf_path'), settings.text('host')
        self.exposed = '' if host in LOOPBACK else EXPOSED.format(host)
        return Page(
            self.robot,
            host,
            settings.integer('port'),
            scale=settings.number('deflection_scale'),
            folder=Path(path).parent if path else None,
            origins=settings.texts('origins'),
        )

    def cleanup(self) -> None:
        """Take the page down."""
        if self.page is not None:
            self.page.close()
            self.inputs.close()
            self.page = None

    # ---- drawing, in a thread of its own

    def activate(self) -> None:
        """Start to draw."""
        settings = self.settings
        self.pace = RateLimiter(settings.number('rate'), settings.number('share'))
        self._stopped.clear()
        self._thread = threading.Thread(target=self._run, name='drawing', daemon=True)
        self._thread.start()

    def deactivate(self) -> None:
        """Stop drawing; the page stays as it is."""
        self._stopped.set()
        if self._thread is not None:
            self._thread.join(5.0)

    def _reset(self) -> str:
        """Discard the topics' last stamps: the next messages may be older."""
        self._reset_wanted = True
        return 'from the next message on'

    def _run(self) -> None:
        try:
            self._draw_while_watched()
        except Exception as error:
            self.fatal = f'drawing failed: {type(error).__name__}: {error}'
        finally:
            self.inputs.shut()

    def _draw_while_watched(self) -> None:
        assert self.page is not None
        seen = time.perf_counter() - LINGER
        while not self._stopped.is_set():
            now = time.perf_counter()
            if self.page.clients:
                seen = now
            if now - seen >= LINGER:
                self.inputs.shut()
                self._stopped.wait(LOOK_PERIOD)
                continue
            if not self.inputs.is_open:
                self._listen(now)
            self._stopped.wait(self._try_to_draw())

    def _listen(self, now: float) -> None:
        self.snapshots.forget()
        self.inputs.listen(self.snapshots.topics)
        self.pace.begin(now)
        self._used = time.process_time()

    def _try_to_draw(self) -> float:
        """Draw; a failure is counted, and drawing goes on. Return as `_draw`."""
        try:
            return self._draw()
        except Exception as error:
            self.guard.note('drawing', error)
            return LOOK_PERIOD

    def _draw(self) -> float:
        """Draw the newest; return how long to wait [s]."""
        assert self.page is not None
        if self._reset_wanted:
            self._reset_wanted = False
            self.inputs.forget()
            self.snapshots.forget()
        self.follow_clock()
        self.inputs.take()
        now = self.clock.now()
        snapshot = self.snapshots.newest(now)
        if snapshot is not None:
            self.page.show(snapshot)
            self._drawn += 1
        self.inputs.listen(self.snapshots.wanted(now))
        # of all threads: the server's, which sends, and the middleware's
        used = time.process_time()
        spent, self._used = used - self._used, used
        return self.pace.wait(time.perf_counter(), spent)

    # ---- diagnostics

    def statuses(self) -> list[Status]:
        """State of the page: pictures, browsers, rate."""
        page = self.page
        if page is None or not self.is_configured:
            return [Status('page', message=self.state)]
        now = time.perf_counter()
        drawn, before = self._drawn, self._drawn_reported
        rate = (drawn - before) / max(now - self._reported, 1e-3)
        self._drawn_reported, self._reported = drawn, now
        clients = page.clients
        status = Status('page', message='served to this machine only')
        status.values = {
            'state': self.state,
            'address': page.address,
            'clients': clients,
            'rate_hz': rate,
            'drawn': drawn,
            'source': self.snapshots.source or 'none',
        }
        if self.state == 'active':
            status.values['allowed_rate_hz'] = 1.0 / self.pace.period
        if self.exposed:
            status.worsen(WARN, self.exposed)
        if clients and self.inputs.is_open and not self.snapshots.source:
            topics = ', '.join(self.settings.texts('state_topics'))
            status.worsen(WARN, f'nothing to draw: no fresh message on {topics}')
        return [status, realtime_status(self.realtime_options)]


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the node (console script `denoc-viewer`)."""
    leave(run(ViewerNode, arguments))


if __name__ == '__main__':
    main()
