"""The benchmark: what it checks, that it says when a result is wrong, what a ratio is."""

from __future__ import annotations

import functools
import json
import sys
from typing import Any

import numpy as np
import pytest
from book.__main__ import main
from book.benchmarks.growth import crossing, slope
from book.benchmarks.results import BenchCheck, BenchLine
from book.benchmarks.timing import Effort, Spread, Subject, Times, compare, ratio

from denoc_ros.dynamics.robot import Robot


@pytest.fixture(autouse=True)
def _environment(monkeypatch: pytest.MonkeyPatch) -> None:
    """The verb sets this for its process; here it must not outlive the test."""
    monkeypatch.setenv('OPENBLAS_NUM_THREADS', '1')


def times(*medians: float) -> Times:
    return Times(float(np.median(medians)), max(medians), np.array(medians))


@pytest.mark.long
def test_quick_run_checks_every_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(['bench', '--quick', '--json']) == 0
    report = json.loads(capsys.readouterr().out)
    lines, operations = report['lines'], report['operations']
    groups = {line['group'] for line in lines}
    assert groups == {
        'inverse',
        'forward',
        'inertia',
        'ssrms',
        'springs',
        'loops',
        'derivatives',
        'growth',
        'dense',
        'batch',
    }
    assert all(found['check']['good'] for found in (*lines, *operations))
    assert {line['reach'] for line in lines} == {None}
    # so few calls say nothing of slopes, not even their sign
    timed = [line for line in lines if line['unit'] != 'slope']
    values = {line['what']: line['value']['value'] for line in timed}
    # so few calls may never see the recursion in front
    crossings = {what: values.pop(what) for what in [*values] if what.startswith('crossing point')}
    assert all(value > 0.0 for value in values.values())
    assert all(value is None or value > 0.0 for value in crossings.values())
    assert {found['verb'] for found in operations} == {
        'inverse dynamics',
        'forward dynamics',
        'inertia matrix and bias',
    }


def test_crossing_beyond_every_size_is_null_in_json() -> None:
    at = crossing([1, 2, 8], [0.2, 0.5, 0.9])
    line = BenchLine('dense', '', '', BenchCheck('', 0.0, 1.0), 'links', Spread(at, 3.0, at))
    record = json.loads(json.dumps(line.record(), allow_nan=False))
    assert record['value'] == {'value': None, 'low': 3.0, 'high': None}


def test_wrong_result_is_said_and_not_timed(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    right = Robot.inverse_dynamics

    @functools.wraps(right)
    def wrong(*args: Any, **more: Any) -> Any:
        return right(*args, **more) * (1.0 + 1e-9)

    monkeypatch.setattr(Robot, 'inverse_dynamics', wrong)
    assert main(['bench', '--quick', '--json', '--only', 'inverse']) == 2
    captured = capsys.readouterr()
    for line in json.loads(captured.out)['lines']:
        assert line['verdict'] == 'wrong'
        assert line['value'] is None
    assert 'inverse_dynamics, rigid n = 6: result must agree with pin.rnea' in captured.err


def test_peer_that_is_missing_is_named(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, 'pinocchio', None)
    assert main(['bench', '--quick', '--only', 'inverse']) == 1
    assert "pip install 'denoc_ros[test]'" in capsys.readouterr().err


def test_subjects_take_turns() -> None:
    order: list[str] = []
    subjects = [Subject(order.append, [(name,)]) for name in ('a', 'b')]
    found = compare(subjects, Effort(blocks=2, seconds=0.0))
    assert order[-4:] == ['a', 'b', 'b', 'a']
    assert [len(each.blocks) for each in found] == [2, 2]


def test_ratio_is_taken_block_by_block() -> None:
    # a machine that halves its speed between blocks changes no ratio
    found = ratio(times(1.0, 2.0, 4.0), times(2.0, 4.0, 8.0))
    assert (found.low, found.value, found.high) == (0.5, 0.5, 0.5)


def test_slope_of_a_power_law_is_its_exponent() -> None:
    sizes = [8, 16, 32]
    found = slope(sizes, [times(n**1.5, 3.0 * n**1.5) for n in sizes])
    assert found.value == pytest.approx(1.5)


@pytest.mark.parametrize(
    ('factors', 'expected'),
    [([2.0, 3.0, 4.0], 1.0), ([0.5, 2.0, 4.0], np.sqrt(4.0)), ([2.0, 0.9, 0.8], np.inf)],
)
def test_crossing_is_where_the_factor_stays_above_one(
    factors: list[float], expected: float
) -> None:
    assert crossing([1, 4, 16], factors) == pytest.approx(expected)
