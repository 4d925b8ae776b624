"""What a robot may say instead of good joint states."""

from __future__ import annotations

import math
import random
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from typing import Any

from node_robots import JOINTS
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState
from trust.stage import FEED, POSTURE, Stage, stamp

NAN, INF = math.nan, math.inf
FLOOD = 10_000.0  # messages per second
BACK_NS, AHEAD_NS = 10_000_000_000, 1_000_000_000_000


@contextmanager
def saying(stage: Stage, says: Callable[[], Sequence[Any]]) -> Iterator[None]:
    stage.robot = says
    try:
        yield
    finally:
        stage.robot = stage.good_state


def instead(make: Callable[[Stage], Any]) -> Callable[[Stage], AbstractContextManager[None]]:
    """Let the robot say this, made anew each time, and nothing else."""
    return lambda stage: saying(stage, lambda: [make(stage)])


def _field(stage: Stage, **fields: Any) -> JointState:
    message = stage.state()
    for name, values in fields.items():
        setattr(message, name, values)
    return message


def not_finite(stage: Stage) -> JointState:
    """Return joint states of which one number is not finite; NaN as a rate or effort is none."""
    name = random.choice(['position', 'velocity', 'effort'])
    bad = random.choice([INF, -INF] + [NAN] * (name == 'position'))
    return _field(stage, **{name: random.choice([[bad, 0.0], [0.0, bad]])})


def wrong_length(stage: Stage) -> JointState:
    name, count = random.choice([('position', 1), ('position', 3), ('velocity', 1), ('effort', 3)])
    return _field(stage, **{name: [0.5] * count})


def wrong_joints(stage: Stage) -> JointState:
    names = random.choice([['j1', 'jx'], ['j1'], ['j1', 'j1']])
    return stage.state([0.5] * len(names), names)


def bytes_of_nothing(stage: Stage) -> bytes:
    """Return a message cut off somewhere, or with random bytes in its place."""
    whole = bytes(serialize_message(stage.state()))
    if random.random() < 0.5:
        return whole[: random.randrange(4, 40)]
    return whole[:4] + random.randbytes(60)


def shuffled(stage: Stage) -> JointState:
    return stage.state(POSTURE[::-1], JOINTS[::-1])


def backwards(stage: Stage) -> JointState:
    message = stage.state([1.5, 1.5])
    stamp(message, time.time_ns() - BACK_NS)
    return message


def jumped(stage: Stage) -> JointState:
    return stage.state([position + random.choice([-1.0, 1.0]) for position in POSTURE])


def duplicates(stage: Stage) -> AbstractContextManager[None]:
    frozen = [stage.state()]
    return saying(stage, lambda: frozen)


def flood(stage: Stage) -> AbstractContextManager[None]:
    count = round(FLOOD / FEED)
    return saying(stage, lambda: [stage.state() for _ in range(count)])


def garbage_flood(stage: Stage) -> AbstractContextManager[None]:
    bad = [not_finite(stage) for _ in range(round(FLOOD / FEED) - 1)]
    return saying(stage, lambda: [*bad, stage.state()])


@contextmanager
def second_publisher(stage: Stage) -> Iterator[None]:
    other = stage.node.create_publisher(JointState, 'joint_states', 10)
    try:
        with saying(stage, lambda: (other.publish(stage.state([1.5, 1.5])), stage.state())[1:]):
            yield
    finally:
        stage.node.destroy_publisher(other)


@contextmanager
def restarted(stage: Stage) -> Iterator[None]:
    """Stop to say anything, then say it by a new publisher."""
    with saying(stage, lambda: ()):
        time.sleep(0.02)  # what the feeding thread has in hand
        stage.node.destroy_publisher(stage.states)
        yield
        stage.states = stage.node.create_publisher(JointState, 'joint_states', 10)


@contextmanager
def from_the_future(stage: Stage) -> Iterator[None]:
    message = stage.state()
    stamp(message, time.time_ns() + AHEAD_NS)
    stage.states.publish(message)
    yield


@contextmanager
def clock_set_back(stage: Stage) -> Iterator[None]:
    stage.clock_offset_ns -= BACK_NS
    yield
