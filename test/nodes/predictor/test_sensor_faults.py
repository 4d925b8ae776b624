"""Detection of faulty sensors by the predictor, over DDS in simulated time."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from gauge_runs import PAYLOAD, ROBOTS
from predictor_faults import (
    ERROR_FLOOR,
    FAULTY_FACTOR,
    GAUGES,
    NAMES,
    RATE,
    Truth,
    truth,
)
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState

from denoc_ros.nodes.base.messages import EVERY_MESSAGE, time_message
from denoc_ros.nodes.predictor import PredictorNode
from denoc_ros.runtime.loop.status import OK, WARN
from denoc_ros.types import Array

pytestmark = pytest.mark.ros
START_NS = 1_000_000_000
PERIOD_NS = round(1e9 / RATE)
INVERTED = GAUGES[0]
MENDED_S, END_S = 0.8, 2.6


class SimulatedArm:
    """Publishes joint states, strain and the time of a true motion, period by period."""

    def __init__(self, graph: Any, true: Truth) -> None:
        self._graph, self._true, self._ticks = graph, true, 0
        make = graph.probe.create_publisher
        self._states, self._strain, self._clock = (
            make(kind, topic, EVERY_MESSAGE)
            for kind, topic in (
                (JointState, 'joint_states'),
                (JointState, 'strain'),
                (Clock, '/clock'),
            )
        )
        self._noise = np.random.default_rng(3)
        self.estimates = graph.collect(JointState, 'predictor/tip_deflection')

    def until_listened(self, node: Any) -> None:
        """Wait until the predictor receives all topics; time stands at the start."""

        def listened() -> bool:
            self._publish(0)
            return bool(self._strain.get_subscription_count() and node.joint_input.received)

        self._graph.until(listened)

    def run(self, end: float, signs: dict[str, float]) -> Array:
        """Go on to a time [s] with factors of gauges; return errors as shares of peaks."""
        errors = []
        while self._ticks < round(end * RATE):
            self._ticks += 1
            self._publish(self._ticks, signs)
            wanted = time_message(START_NS + self._ticks * PERIOD_NS)
            self._graph.until(
                lambda stamp=wanted: self.estimates and self.estimates[-1].header.stamp == stamp
            )
            found = np.array(self.estimates[-1].position)
            errors.append(np.abs(found - self._true.deflection[self._ticks]) / self._true.peak)
        return np.asarray(np.max(errors, axis=1))

    def _publish(self, tick: int, signs: dict[str, float] | None = None) -> None:
        true, time = self._true, np.array([tick / RATE])
        stamp = time_message(START_NS + tick * PERIOD_NS)
        motion = true.signals['joints'](time)[0]
        state = JointState(name=NAMES, position=motion[:3].tolist(), velocity=motion[3:].tolist())
        strain = JointState(name=GAUGES)
        for gauge in GAUGES:
            value = true.signals[gauge](time)[0, 0]
            value += true.noise[gauge] * self._noise.standard_normal()
            strain.position.append((signs or {}).get(gauge, 1.0) * value)
        for publisher, message in ((self._states, state), (self._strain, strain)):
            message.header.stamp = stamp
            publisher.publish(message)
        self._clock.publish(Clock(clock=stamp))


def predictor(graph: Any, **parameters: Any) -> Any:
    """Return a predictor of the arm that fuses its gauges."""
    return graph.add(
        PredictorNode, urdf_path=str(ROBOTS / 'canadarm_gauges.urdf'), gravity=[0.0, 0.0, 0.0],
        update_rate=RATE, use_sim_time=True, strain='fuse', payload__tool__mass=PAYLOAD,
        **parameters,
    )  # fmt: skip


def until_reported(graph: Any, level: bytes, *words: str) -> None:
    """Wait for a status of the fusion with a level and words."""

    def reported() -> bool:
        status = graph.diagnostics.get('predictor: fusion')
        return bool(status and status.level == level and all(w in status.message for w in words))

    graph.until(reported)


def test_inverted_gauge_is_named_and_excluded_until_it_agrees(graph: Any) -> None:
    arm = SimulatedArm(graph, truth('exact', END_S))
    arm.until_listened(predictor(graph))
    bound = FAULTY_FACTOR * ERROR_FLOOR
    assert arm.run(MENDED_S, {INVERTED: -1.0}).max() <= bound
    until_reported(graph, WARN, 'excluded', INVERTED)
    assert arm.run(END_S, {}).max() <= bound
    until_reported(graph, OK, 'fusing')
    assert graph.value('predictor: fusion', f'{INVERTED} trusted') == 'yes'


def test_a_message_without_one_gauge_gives_the_others(graph: Any) -> None:
    arm = SimulatedArm(graph, truth('exact', END_S))
    node = predictor(graph)
    arm.until_listened(node)
    assert arm.run(MENDED_S, {INVERTED: math.nan}).max() <= FAULTY_FACTOR * ERROR_FLOOR
    missing, *others = (counts['accepted'] for counts in node.observer.fusion.counts)
    assert missing < 10  # of the messages before the motion
    assert min(others) > 0.8 * MENDED_S * RATE
    monitor = next(each for each in node.monitors if each.topic == '/strain')
    assert monitor.rejected['non_finite'] == round(MENDED_S * RATE)
    graph.until(
        lambda: INVERTED in getattr(graph.diagnostics.get('predictor: inputs'), 'message', '')
    )


def test_infinite_patience_never_uses_an_excluded_gauge_again(graph: Any) -> None:
    arm = SimulatedArm(graph, truth('exact', END_S))
    node = predictor(graph, fusion__patience=math.inf)
    faults = node.observer.fusion.faults
    arm.until_listened(node)
    arm.run(MENDED_S, {INVERTED: -1.0})
    arm.run(END_S, {})
    assert not faults.trusted[0]
