"""Nodes under random faults of their inputs, in process: see `trust.inputs.input_faults`."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import rclpy
from command_faults import CommandedNode
from fault_draws import KINDS, Draw, Violation, drawn, good_streams, in_order
from predictor_faults import END, MOTIONS, SOURCES, TRUTHS, PredictorFaults, truth
from rclpy.signals import SignalHandlerOptions
from trust.inputs.input_faults import NODES, campaign, main, under_faults

pytestmark = pytest.mark.ros

DRAWS = {'predictor': 500, 'feedforward': 600, 'shaper': 100, 'plant': 800}


@pytest.fixture(scope='module', autouse=True)
def context() -> Iterator[None]:
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    yield
    rclpy.try_shutdown()


@pytest.fixture(scope='module')
def predictor(
    tmp_path_factory: pytest.TempPathFactory, context: None
) -> Iterator[PredictorFaults]:
    with under_faults('predictor', tmp_path_factory.mktemp('faults')) as node:
        assert isinstance(node, PredictorFaults)
        yield node


@pytest.mark.parametrize('name', NODES)
def test_no_draw_of_faults_breaks_a_law(name: str, tmp_path: Path) -> None:
    kinds, broken = campaign(name, range(DRAWS[name]), tmp_path)
    assert broken == []
    assert min(kinds.values()) >= DRAWS[name] // 40


def test_a_broken_law_is_written_with_the_seed_that_repeats_it(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    class Broken:
        def __init__(self, _folder: Path) -> None: ...
        def close(self) -> None: ...

        def kinds(self, seed: int) -> tuple[str, ...]:
            return ('offset',)

        def violations(self, seed: int) -> list[Violation]:
            return [Violation('possible', seed, 'quick', ('offset',), 'it bent')][: seed % 2]

    monkeypatch.setitem(NODES, 'plant', Broken)
    monkeypatch.setattr(
        'trust.inputs.input_faults.rclpy', SimpleNamespace(init=_ignore, shutdown=_ignore)
    )
    assert main(['--count', '4', '--node', 'plant']) == 1
    told = capsys.readouterr().out
    assert 'plant: 2 of 4 draws break a law' in told
    assert '--node plant --seed 3: offset (quick): possible: it bent' in told
    assert main(['--seed', '2', '--node', 'plant']) == 0


def _ignore(*_given: object, **_options: object) -> None: ...


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
    assert found.error(true) < 0.03
    if MOTIONS[name][2]:  # The model is exact: gauges only add their noise.
        assert alone.error(true) < 0.003
    else:
        assert found.error(true) < 0.5 * alone.error(true)
    assert all(good for _, good, _ in found.reports)


def test_a_seed_gives_the_same_run(predictor: PredictorFaults) -> None:
    first = [predictor.violations(seed) for seed in range(12)]
    again = [predictor.violations(seed) for seed in reversed(range(12))]
    assert first == again[::-1]


def test_every_node_gives_the_same_run_for_a_seed(tmp_path: Path) -> None:
    for name in ('feedforward', 'plant'):
        with under_faults(name, tmp_path) as node:
            assert isinstance(node, CommandedNode)
            runs = [node.usual(100.0).copy() for _ in range(2) if node.violations(3) is not None]
            node._usual.clear()
            runs.append(node.usual(100.0))
        np.testing.assert_array_equal(runs[0], runs[1])
        np.testing.assert_array_equal(runs[0], runs[2])


def test_what_nobody_received_leaves_gaps_and_no_output(predictor: PredictorFaults) -> None:
    assert np.isnan(predictor.run([]).deflection).all()
