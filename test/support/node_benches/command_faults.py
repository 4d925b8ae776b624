"""Feedforward, shaper and plant under faults of what commands them, and the laws they keep."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from fault_draws import (
    JOINT_KINDS,
    JOINTS,
    SENSOR_KINDS,
    SINGLE_KINDS,
    TIMING_KINDS,
    Draw,
    Message,
    Sources,
    Violation,
    drawn,
    faulty_streams,
    good_streams,
    in_order,
)
from gauge_runs import PAYLOAD
from hand_fed import START_NS, HandFedNode, joint_state_bytes
from predictor_faults import (
    DETECTION_S,
    END,
    ERROR_FLOOR,
    NAMES,
    RATE,
    SILENT_FACTOR,
    TRACE_SHARE,
    TURNED,
    robot_text,
    truth,
)
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from denoc_ros.bags.cdr import stamp_bytes
from denoc_ros.nodes.base.messages import CommandMessage, template
from denoc_ros.nodes.feedforward import FeedforwardNode
from denoc_ros.nodes.plant import PlantNode
from denoc_ros.planning.shaper import ShaperNode
from denoc_ros.types import Array

REFERENCE, COMMANDS = 'reference', 'commands'
MOTION = 'quick'  # that is commanded: a truth of the predictor
EFFORT = 5000.0  # N m, of the robot's file
MAX_DELTA = 200.0  # N m per tick
TORQUE = np.array([200.0, 100.0, 50.0])  # N m, amplitude of the plant's commands
VELOCITY = 1.0  # rad/s, of the robot's file
STREAM_RATES = (50.0, 100.0, 200.0)  # Hz
TICKS = round(RATE * END)
# what one message may be that a stream has besides good ones
STREAM_KINDS = (*JOINT_KINDS, 'dropped', *SINGLE_KINDS[:2], SINGLE_KINDS[3], *TIMING_KINDS)
COMMAND_KINDS = (
    *(kind for kind in SENSOR_KINDS if kind not in ('swapped', 'wrong_field')),
    'value_spike', 'not_finite', *TIMING_KINDS[:3],
)  # fmt: skip


class StreamedPoint:
    """A message of one point with positions and velocities, without accelerations."""

    def __init__(self) -> None:
        count, markers = len(NAMES), (1.25e100, 1.25e101)
        point = JointTrajectoryPoint(
            positions=[markers[0]] * count, velocities=[markers[1]] * count
        )
        message = JointTrajectory(joint_names=list(NAMES), points=[point])
        self._raw, offsets = template(message, markers)
        self._rows = [np.frombuffer(self._raw, '<f8', count, offset) for offset in offsets]

    def bytes(self, message: Message) -> bytes:
        """Return the bytes of a point."""
        assert message.velocity is not None
        self._rows[0][:], self._rows[1][:] = message.position, message.velocity
        self._raw[4:12] = stamp_bytes(START_NS + round(1e9 * message.stamp))
        return bytes(self._raw)


class CommandedNode:
    """A node that is commanded by streams; see its subclasses.

    Attributes
    ----------
    name : str
    sources : Sources
    scale : (c,) array
        What its output is compared by.
    """

    name: str
    sources: Sources
    make: type
    topic: str
    width = 3  # values of the output

    def __init__(self, folder: Path) -> None:
        file = folder / 'arm.urdf'
        file.write_text(re.sub(r' topic="\w*"', '', robot_text()))  # no gauges
        given = {'urdf_path': str(file), 'gravity': [0.0, 0.0, 0.0], 'update_rate': RATE}
        self.bench = HandFedNode(self.make, **given, **self.parameters())
        self._usual: dict[float, Array] = {}
        self._point_in = StreamedPoint()
        self.prepare()

    def parameters(self) -> dict[str, Any]:
        """Return the node's own parameters."""
        return {}

    def prepare(self) -> None:
        """Prepare what a run needs."""

    def signals(self) -> dict[str, Any]:
        """Return the true signals of all channels."""
        joints = truth(MOTION).signals[JOINTS]
        return dict.fromkeys(self.sources.moving, joints)

    def encode(self, message: Message) -> tuple[str, bytes]:
        """Return the topic and the bytes of a message."""
        if message.channel == JOINTS:
            raw = joint_state_bytes(NAMES, message.stamp, message.position, message.velocity)
            return 'joint_states', raw
        return self.topic, self._point_in.bytes(message)

    def output(self) -> Array | None:
        """Return what has left in a tick (width,), None if nothing."""
        raise NotImplementedError

    def unlawful(self, output: Array) -> Iterator[str]:
        """Yield what must never leave; `output` (ticks, width) is NaN where nothing left."""
        raise NotImplementedError

    def close(self) -> None:
        self.bench.close()

    def kinds(self, seed: int) -> tuple[str, ...]:
        """Return the kinds of the faults of a seed."""
        return drawn(seed, self.sources).kinds

    def run(self, messages: Sequence[Message]) -> tuple[Array, int, list[tuple[float, bool]]]:
        """Return the output (ticks, width), refusals, and whether reports said OK."""
        bench, place, refused = self.bench, 0, 0
        bench.node._tick_guard.last = ''
        bench.begin()
        found = np.full((TICKS, self.width), np.nan)
        reports: list[tuple[float, bool]] = []
        for k in range(TICKS):
            now = k / RATE
            while place < len(messages) and messages[place].arrival <= now + 1e-9:
                message = messages[place]
                refused += bench.give(*self.encode(message), message.arrival) and message.faulty
                place += 1
            bench.tick(now)
            if (left := self.output()) is not None:
                found[k] = left
            if k % round(RATE) == round(RATE) - 1:
                reports.append((now, bench.says_ok()))
        return found, refused, reports

    def violations(self, seed: int) -> list[Violation]:
        """Return the laws that a draw breaks."""
        draw = drawn(seed, self.sources)
        signals = self.signals()
        noise = dict.fromkeys(signals, self.noise)
        moving = self.sources.moving
        good = good_streams(draw, signals, {**noise, **dict.fromkeys(moving, 0.0)}, END, moving)
        messages = in_order(faulty_streams(draw, good, signals, noise))
        found, refused, reports = self.run(messages)
        details = [('possible', each) for each in self.unlawful(found)]
        if failed := self.bench.node._tick_guard.last:
            details.append(('no tick fails', failed))
        single = [message for message in messages if message.faulty]
        if single and refused == len(single):
            without = self.run([message for message in messages if not message.faulty])[0]
            gap = self.gap(found, without)
            if gap > TRACE_SHARE:
                details.append(('no trace', f'{gap:.3g} of the largest output'))
        details += self.silent(draw, found, reports)
        return [Violation(law, seed, MOTION, draw.kinds, detail) for law, detail in details]

    noise = 1e-3

    def silent(
        self, draw: Draw, found: Array, reports: list[tuple[float, bool]]
    ) -> Iterator[tuple[str, str]]:
        """Yield reports that say OK while one wrong message still spoils the output."""
        if not set(draw.kinds) <= {*SINGLE_KINDS, *TIMING_KINDS}:
            return
        usual = self.usual(draw.rate)
        for at, good in reports:
            gap = self.gap(*(each[[round(at * RATE)]] for each in (found, usual)))
            if good and gap > SILENT_FACTOR * ERROR_FLOOR and at > draw.begin + DETECTION_S:
                yield 'not silent', f'OK at {at:.2f} s with an error of {gap:.3g}'

    def usual(self, rate: float) -> Array:
        """Return the output without faults."""
        if rate not in self._usual:
            plain = Draw(0, rate, ())
            signals, moving = self.signals(), self.sources.moving
            good = good_streams(plain, signals, dict.fromkeys(signals, 0.0), END, moving)
            self._usual[rate] = self.run(in_order(good))[0]
        return self._usual[rate]

    def gap(self, one: Array, other: Array) -> float:
        """Return the largest difference as a share of the largest output; infinite in silence."""
        if not np.array_equal(np.isnan(one), np.isnan(other)):
            return np.inf
        largest = np.nanmax(np.abs(self.usual(STREAM_RATES[1])), axis=0)
        return float(np.nanmax(np.abs(one - other) / largest, initial=0.0))


class FeedforwardFaults(CommandedNode):
    """A feedforward that follows a streamed reference beside joint states."""

    name, make, topic = 'feedforward', FeedforwardNode, 'reference'
    sources = Sources((), (JOINTS, REFERENCE), len(NAMES), STREAM_KINDS, STREAM_RATES)

    def parameters(self) -> dict[str, Any]:
        return {'model': 'flexible', 'max_delta_tau': MAX_DELTA, 'payload.tool.mass': PAYLOAD}

    def output(self) -> Array | None:
        sent = self.bench.sent.get('feedforward/commands')
        return np.frombuffer(sent[0][-24:], '<f8') if sent else None

    def unlawful(self, output: Array) -> Iterator[str]:
        given = output[np.isfinite(output).any(axis=1)]
        if not np.isfinite(given).all():
            yield 'torque must be finite'
        if np.abs(given).max(initial=0.0) > EFFORT:
            yield f'torque must be within {EFFORT:g} N m, got {np.abs(given).max():.4g}'
        change = np.abs(np.diff(given, axis=0)).max(initial=0.0)
        if change > MAX_DELTA * (1.0 + 1e-9):
            yield f'torque must change by at most {MAX_DELTA:g} N m per tick, got {change:.4g}'


class ShaperFaults(CommandedNode):
    """A shaper of a streamed motion."""

    name, make, topic = 'shaper', ShaperNode, '~/input'
    sources = Sources((), (JOINTS, REFERENCE), len(NAMES), STREAM_KINDS, STREAM_RATES)
    width = 6

    def parameters(self) -> dict[str, Any]:
        return {'method': 'zvd', 'modes': 2, 'limits.effort': [EFFORT]}

    def prepare(self) -> None:
        self._left: list[bytes] = []
        self.bench.node._reference = SimpleNamespace(
            publish=self._left.append, get_subscription_count=lambda: 1
        )
        self._point = self.bench.node._point

    def output(self) -> Array | None:
        if not self._left:
            return None
        self._left.clear()
        return np.concatenate((self._point.positions, self._point.velocities))

    def unlawful(self, output: Array) -> Iterator[str]:
        given = output[np.isfinite(output).any(axis=1)]
        if not np.isfinite(given).all():
            yield 'motion must be finite'
        rate = np.abs(given[:, 3:]).max(initial=0.0)
        bound = self.bench.node.bounds.table[3].max()
        if rate > bound:
            yield f'rates must be within {bound:g} rad/s, got {rate:.3g}'


class PlantFaults(CommandedNode):
    """A plant under commands of torque."""

    name, make, topic = 'plant', PlantNode, 'feedforward/commands'
    sources = Sources((COMMANDS,), (), len(NAMES), COMMAND_KINDS, STREAM_RATES)
    width, noise = 10, 1.0  # N m

    def parameters(self) -> dict[str, Any]:
        return {'start': TURNED.tolist(), 'brake': False, 'payload.tool.mass': PAYLOAD}

    def prepare(self) -> None:
        self._command = CommandMessage(NAMES)

    def signals(self) -> dict[str, Any]:
        return {COMMANDS: lambda times: np.outer(np.sin(np.pi * times), TORQUE)}

    def encode(self, message: Message) -> tuple[str, bytes]:
        self._command.values[:] = message.position
        return self.topic, self._command.bytes()

    def output(self) -> Array | None:
        sent = self.bench.sent
        if 'joint_states' not in sent:
            return None
        state = self.bench.node._state_message
        modal = self.bench.node._modal_message
        return np.concatenate((state.position, modal.position))

    def unlawful(self, output: Array) -> Iterator[str]:
        given = output[np.isfinite(output).any(axis=1)]
        if not np.isfinite(given).all():
            yield 'state must be finite'
        bent = np.abs(given[:, 3:][:, self.bench.node.robot.flexible_indices])
        if bent.max(initial=0.0) > 3.5:  # m: half of the longer link
            yield f'amplitudes must be within 3.5 m, got {bent.max():.3g}'

    def silent(
        self, draw: Draw, found: Array, reports: list[tuple[float, bool]]
    ) -> Iterator[tuple[str, str]]:
        """Yield reports that say OK after the state has diverged: then nothing left in a tick."""
        lost = np.flatnonzero(np.isnan(found).any(axis=1))
        for at, good in reports:
            if good and len(lost) and at * RATE > lost[0]:
                yield 'not silent', f'OK at {at:.2f} s after a state that was not published'
