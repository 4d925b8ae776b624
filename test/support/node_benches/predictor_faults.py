"""Runs of a predictor under faults of its inputs, and the laws that its output keeps."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from fault_draws import (
    JOINT_KINDS,
    JOINTS,
    SENSOR_KINDS,
    Draw,
    Message,
    Signals,
    Sources,
    Streams,
    Violation,
    drawn,
    faulty_streams,
    good_streams,
    in_order,
)
from gauge_runs import PAYLOAD, ROBOTS, STEP, load, recorded, softer
from hand_fed import HandFedNode, JointStateView, joint_state_bytes

from denoc_ros.nodes.predictor import PredictorNode
from denoc_ros.runtime.loop.status import OK
from denoc_ros.runtime.safety.restarts import Restarts
from denoc_ros.trajectories import CycloidalTrajectory
from denoc_ros.types import Array

END = 2.5  # s of each run
RATE = 100.0  # Hz of the node
TIMEOUT = 0.3  # s, of joint states: the slowest come at 5 Hz
REPORTS = (1.0, 2.0, END)  # s: when /diagnostics is published
GAUGES = ('link_1_y_root', 'link_1_y_middle', 'link_2_y_root', 'link_2_y_middle')
TURNED = np.array([2.9, 0.4, -0.3])  # rad where the joints begin: the first passes pi
NAMES = ('joint_1', 'joint_2', 'joint_3')
# of true motions: angle [rad] and time [s] of each joint, and whether the model is exact
MOTIONS = {
    'exact': ((0.3, 0.3, 0.3), 4.0, True),
    'perturbed': ((0.3, 0.3, 0.3), 4.0, False),
    'quick': ((0.3, -0.2, 0.1), 1.5, True),
}
TRUTHS = tuple(MOTIONS)
SOURCES = Sources(GAUGES, (JOINTS,), len(NAMES))
# bounds of the laws
DETECTION_S = 1.0  # in which a fault may act before it is found
CLEAR_SIGMAS = 5.0  # from the truth: what counts as a difference
CLEAR_S = 0.5  # of that time, in total: a sensor that soon agrees is not judged
# Standard deviation of a value by the model's errors, as a share of it: a sensor that differs by
# less than 30 % may be right, and the stiffness or the load wrong.
MODEL_SHARE = 0.06
TRACE_SHARE = 1e-3  # of the peak, after a refused message
FAULTY_FACTOR = 3.0  # times the error without the faulty sensor
ALL_FAULTY_FACTOR = 1.5  # times the error of the joints alone
SILENT_FACTOR = 10.0  # times the normal error, while diagnostics say OK
ERROR_FLOOR = 0.01  # of the peak: the gauges' noise
DEFLECTION_SHARE = 0.5  # of a beam's length


@dataclass(frozen=True)
class Truth:
    """What happens: the signals of all channels, and deflections at the node's ticks."""

    name: str
    signals: Signals
    noise: dict[str, float]
    deflection: Array  # (ticks, 6 links)
    peak: Array  # (6 links,), infinite for what does not move
    still: Array  # (steps,) whether the joints rest, every STEP


@dataclass
class Outcome:
    """What a predictor said."""

    deflection: Array  # (ticks, 6 links), NaN where nothing left
    pose: Array  # (ticks, 7), NaN likewise
    reports: list[tuple[float, bool, str]]  # time, whether all is OK, all messages
    refused: Counter[str]  # messages of each channel, by input, observer or fusion
    spoilt: int  # good messages that an input refused
    alarm: str = ''  # what failed

    def error(self, truth: Truth, begin: float = 0.0, end: float = END) -> float:
        """Largest error between two times, as a share of the peak; 0 where nothing left."""
        rows = slice(_tick(begin), _tick(end))
        share = np.abs(self.deflection[rows] - truth.deflection[rows]) / truth.peak
        return float(np.nanmax(share, initial=0.0))


def _tick(time: float) -> int:
    return round(time * RATE)


@cache
def robot_text() -> str:
    """Return the Canadarm with a continuous first joint and a topic for each gauge."""
    text = (ROBOTS / 'canadarm_gauges.urdf').read_text()
    first = text.index('<joint name="joint_1" type="revolute">')
    text = text[:first] + text[first:].replace('type="revolute"', 'type="continuous"', 1)
    text = text.replace(
        '<limit effort="5000" velocity="1" lower="-6.2831853" upper="6.2831853"/>',
        '<limit effort="5000" velocity="1"/>',
        1,
    )
    for name in GAUGES:
        start = text.index(f'<sensor name="{name}"')
        text = text[:start] + text[start:].replace('topic="strain"', f'topic="{name}"', 1)
    return text


@cache
def truth(name: str, end: float = END) -> Truth:
    """Return a true motion up to a time [s]."""
    angles, period, exact = MOTIONS[name]
    robot = load('canadarm')
    if not exact:
        robot = robot.with_overrides(softer(robot))
    robot.set_payload('tool', PAYLOAD if exact else 1.2 * PAYLOAD)
    path = CycloidalTrajectory(TURNED, np.array(angles) / period, np.full(3, period))

    def wanted(t: float) -> tuple[Array, Array, Array]:
        q, qd, qdd = np.zeros((3, 3))
        path.sample(t, q, qd, qdd)
        return q, qd, qdd

    data = recorded(robot, wanted, end + 2.0 * STEP)
    joints = robot.joint_indices
    at = data.run.t
    motion = np.hstack([data.run.q[:, joints], data.run.qd[:, joints]])

    def signal(columns: Array) -> Callable[[Array], Array]:
        def values(times: Array) -> Array:
            return np.column_stack([np.interp(times, at, column) for column in columns.T])

        return values

    noise = {s.name: float(s.noise) for s in robot.tree.sensors}
    signals = {JOINTS: signal(motion)}
    for k, gauge in enumerate(GAUGES):
        signals[gauge] = signal(data.strain[:, [k]])
    every = round(1.0 / (RATE * STEP))
    peak = np.abs(data.deflection).max(axis=0)
    moves = peak > 1e-3
    still = np.abs(data.run.qd[:, joints]).max(axis=1) < 1e-6
    return Truth(
        name, signals, noise, data.deflection[::every], np.where(moves, peak, np.inf), still
    )


class PredictorFaults:
    """A predictor with gauges, and one without, under drawn faults."""

    def __init__(self, folder: Path) -> None:
        file = folder / 'arm.urdf'
        file.write_text(robot_text())
        given = {
            'urdf_path': str(file), 'gravity': [0.0, 0.0, 0.0], 'update_rate': RATE,
            'joint_state_timeout': TIMEOUT, 'payload.tool.mass': PAYLOAD, 'marker_rate': 0.0,
            'strain': 'fuse',
        }  # fmt: skip
        self.bench = HandFedNode(PredictorNode, **given)
        self.alone = HandFedNode(PredictorNode, **{**given, 'strain': 'ignore'})
        for topic in GAUGES:
            self.bench.node.sensors._subscribe(f'/{topic}', 'sensor_msgs/msg/JointState')
        self._view = JointStateView()
        self._errors: dict[tuple[object, ...], float] = {}

    def close(self) -> None:
        self.bench.close()
        self.alone.close()

    def run(self, messages: Sequence[Message], bench: HandFedNode | None = None) -> Outcome:
        """Run the node over messages in the order of their arrival."""
        bench = bench or self.bench
        node = bench.node
        # The node's estimate and all that it has counted begin with each run.
        node.observer = node._build(node.robot, node.settings)
        node.restarts, node._counted = Restarts(node.observer.bounds), 0
        node.outputs.attach(node.observer, node.robot.pose_of(node.tip))
        bench.begin()
        ticks = _tick(END)
        deflection = np.full((ticks, len(node.observer.deflections.names)), np.nan)
        pose = np.full((ticks, 7), np.nan)
        reports: list[tuple[float, bool, str]] = []
        refused, spoilt = Counter[str](), 0
        place, reported = 0, [_tick(at) - 1 for at in REPORTS]
        for k in range(ticks):
            now = k / RATE
            while place < len(messages) and messages[place].arrival <= now + 1e-9:
                message = messages[place]
                count = self._give(bench, message)
                refused[message.channel] += count
                spoilt += not message.faulty and count > 0
                place += 1
            bench.tick(now)
            sent = bench.sent
            if raw := sent.get('predictor/tip_deflection'):
                deflection[k] = self._view.values(raw[0])
                pose[k] = np.frombuffer(sent['predictor/tip_pose'][0][-56:], '<f8')
            if k in reported:
                said = bench.statuses()
                good = all(status.level == OK for status in said)
                told = '; '.join(s.message for s in said if s.level != OK)
                reports.append((now, good, told))
        observer = node.observer
        refused[JOINTS] += observer.late + observer.repeated
        if observer.fusion is not None:
            for gauge, counts in zip(observer.fusion.names, observer.fusion.counts, strict=True):
                refused[gauge] += counts.total() - counts['accepted']
        return Outcome(deflection, pose, reports, refused, spoilt, node._tick_guard.last)

    def _give(self, bench: HandFedNode, message: Message) -> int:
        """Hand a message over; return how many messages are refused for it."""
        if message.channel == JOINTS:
            topic, names = 'joint_states', list(NAMES)
        elif bench is self.alone:
            return 0
        else:
            topic, names = f'/{message.channel}', [message.channel]
        raw = joint_state_bytes(names, message.stamp, message.position, message.velocity)
        return bench.give(topic, raw, message.arrival)

    # ---- laws

    def normal_error(self, name: str, rate: float, missing: frozenset[str] = frozenset()) -> float:
        """Return the largest error without faults, without some of the gauges; share of peaks."""
        key = name, rate, missing
        if key not in self._errors:
            true, plain = truth(name), Draw(0, rate, ())
            streams = good_streams(plain, true.signals, true.noise, END)
            messages = in_order({c: s for c, s in streams.items() if c not in missing})
            bench = self.alone if missing.issuperset(GAUGES) else self.bench
            self._errors[key] = max(self.run(messages, bench).error(true), ERROR_FLOOR)
        return self._errors[key]

    def kinds(self, seed: int) -> tuple[str, ...]:
        """Return the kinds of the faults of a seed."""
        return drawn(seed, SOURCES).kinds

    def violations(self, seed: int) -> list[Violation]:
        """Return the laws that a draw breaks."""
        draw = drawn(seed, SOURCES)
        name = TRUTHS[seed % len(TRUTHS)]
        true = truth(name)
        good = good_streams(draw, true.signals, true.noise, END)
        faulty = faulty_streams(draw, good, true.signals, true.noise)
        messages = in_order(faulty)
        found = self.run(messages)

        def told(law: str, detail: str) -> Violation:
            return Violation(law, seed, name, draw.kinds, detail)

        laws = [told('no tick fails', found.alarm)] if found.alarm else []
        laws += [told('possible', detail) for detail in _impossible(found)]
        if not set(draw.kinds) & {*SENSOR_KINDS, *JOINT_KINDS}:
            without = self.run([message for message in messages if not message.faulty])
            single = Counter(message.channel for message in messages if message.faulty)
            refused = all(
                found.refused[channel] - without.refused[channel] >= count
                for channel, count in single.items()
            )
            # A message that makes the node refuse good ones counts as refused itself.
            if refused or found.spoilt:
                detail = _trace(found, without, true, draw.begin)
                laws += [told('no trace', detail)] if detail else []
        usual = self.normal_error(name, draw.rate)
        laws += [told('not silent', detail) for detail in _silent(found, true, draw, usual)]
        laws += [told(*each) for each in self._sensor_laws(found, true, draw, good, faulty)]
        return laws

    def _sensor_laws(
        self, found: Outcome, true: Truth, draw: Draw, good: Streams, faulty: Streams
    ) -> Iterator[tuple[str, str]]:
        """Yield the laws of faulty gauges that are broken, each with its numbers."""
        if not set(draw.kinds) <= set(SENSOR_KINDS):
            return
        seen = {
            gauge: _clear_since(true, gauge, good[gauge], faulty[gauge])
            for gauge in GAUGES
            if any(message.faulty for message in faulty[gauge])
        }
        late = max(seen.values(), default=np.inf)
        told = ''.join(text for at, _, text in found.reports if at >= late + DETECTION_S)
        # Where several contradict each other, the joints alone may be used, and a warning is due.
        for gauge, since in seen.items() if len(seen) == 1 else ():
            if since + DETECTION_S < END - 0.02 and gauge not in told:
                yield 'sensor is named', f'{gauge} differs since {since:.2f} s, said: {told!r}'
        if not late + DETECTION_S < END - 0.02:
            return
        missing = frozenset(seen)
        if 1 < len(missing) < len(GAUGES):
            return  # some of several: the other laws hold
        factor = ALL_FAULTY_FACTOR if len(missing) == len(GAUGES) else FAULTY_FACTOR
        bound = factor * self.normal_error(true.name, draw.rate, missing)
        error = found.error(true, late + DETECTION_S)
        if error > bound:
            yield 'error is bounded', f'{error:.3g} of the peak must be <= {bound:.3g}'


def _impossible(found: Outcome) -> Iterator[str]:
    """Yield what was published that the robot cannot have."""
    given = np.isfinite(found.deflection).any(axis=1)
    if not np.isfinite(found.deflection[given]).all():
        yield 'deflections must be finite'
    for link, length in enumerate((6.0, 7.0)):
        reach = np.nanmax(np.abs(found.deflection[:, 6 * link : 6 * link + 3]), initial=0.0)
        if reach > DEFLECTION_SHARE * length:
            bound = DEFLECTION_SHARE * length
            yield f'deflection of link {link + 1} must be <= {bound:g} m, got {reach:.3g} m'
    length = np.linalg.norm(found.pose[given, 3:], axis=1)
    if not (np.abs(length - 1.0) < 1e-6).all():
        yield 'quaternions must have unit length'
    if not (np.linalg.norm(found.pose[given, :3], axis=1) < 15.5).all():
        yield 'the pose must be within reach'


def _trace(found: Outcome, without: Outcome, true: Truth, begin: float) -> str:
    """Return by how much refused messages change the output; '' within the bound."""
    rows = slice(_tick(begin), None)
    here, there = found.deflection[rows], without.deflection[rows]
    if not np.array_equal(np.isnan(here), np.isnan(there)):
        return 'other ticks publish'
    gap = float(np.nanmax(np.abs(here - there) / true.peak, initial=0.0))
    return f'{gap:.3g} of the peak' if gap > TRACE_SHARE else ''


def _silent(found: Outcome, true: Truth, draw: Draw, usual: float) -> Iterator[str]:
    """Yield reports that say OK while the output is wrong."""
    for at, good, _ in found.reports:
        error = found.error(true, at - 0.5 / RATE, at + 0.5 / RATE)
        if good and error > SILENT_FACTOR * usual and at > draw.begin + DETECTION_S:
            yield f'OK at {at:.2f} s with an error of {error:.3g} of the peak'


def _clear_since(true: Truth, gauge: str, good: list[Message], faulty: list[Message]) -> float:
    """Return since when a gauge has differed clearly while the joints move [s]."""
    right = {message.stamp: message.position[0] for message in good}
    interval, total = faulty[1].stamp - faulty[0].stamp, 0.0
    for message in faulty:
        if not message.faulty or true.still[round(message.stamp / STEP)]:
            continue
        expected = right[message.stamp]
        deviation = np.hypot(true.noise[gauge], MODEL_SHARE * expected)
        if abs(message.position[0] - expected) > CLEAR_SIGMAS * deviation:
            total += interval
            if total > CLEAR_S - 0.5 * interval:
                return message.stamp - CLEAR_S
    return np.inf
