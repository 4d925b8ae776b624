"""Nodes under random faults of their inputs, in process: see `trust.input_faults`."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
import rclpy
from fault_draws import KINDS, Draw, drawn, good_streams, in_order
from predictor_faults import END, SOURCES, TRUTHS, PredictorFaults, truth
from rclpy.signals import SignalHandlerOptions

pytestmark = pytest.mark.ros


@pytest.fixture(scope='module')
def predictor(tmp_path_factory: pytest.TempPathFactory) -> Iterator[PredictorFaults]:
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    node = PredictorFaults(tmp_path_factory.mktemp('faults'))
    yield node
    node.close()
    rclpy.try_shutdown()


def test_every_kind_of_fault_is_drawn() -> None:
    draws = [drawn(seed, SOURCES) for seed in range(500)]
    assert {kind for draw in draws for kind in draw.kinds} == set(KINDS)
    assert {len(draw.faults) for draw in draws} == {1, 2}
    assert min(draw.rate for draw in draws) == 5.0
    assert max(draw.rate for draw in draws) == 1000.0


@pytest.mark.parametrize('name', TRUTHS)
def test_without_faults_the_gauges_correct_the_model(
    predictor: PredictorFaults, name: str
) -> None:
    true, draw = truth(name), Draw(0, 100.0, ())
    streams = good_streams(draw, true.signals, true.noise, END)
    found = predictor.run(in_order(streams))
    alone = predictor.run(in_order(streams), predictor.alone)
    assert found.error(true) < min(0.03, 0.5 * alone.error(true))
    assert all(good for _, good, _ in found.reports)


def test_a_seed_gives_the_same_run(predictor: PredictorFaults) -> None:
    first = [predictor.violations(seed) for seed in range(12)]
    again = [predictor.violations(seed) for seed in reversed(range(12))]
    assert first == again[::-1]


def test_what_nobody_received_leaves_gaps_and_no_output(predictor: PredictorFaults) -> None:
    assert np.isnan(predictor.run([]).deflection).all()
