"""Recordings with gaps anywhere end in a verdict or in a clear error."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from identification_runs import recorded, sweeping

import denoc_ros as dn
from denoc_ros.dynamics.robot import Robot
from denoc_ros.identification.model.sources import Recording
from denoc_ros.types import Array, Flags

ROBOTS = Path(__file__).resolve().parents[3] / 'config' / 'robots'
LENGTHS = (0.05, 0.3, 0.9, 2.0)  # s, of gaps
FREE = ['beam.*.ei', 'sensor.*.gain', 'sensor.*.offset', 'joint.*.friction', 'effort.*.offset']
GAUGE = (
    '<sensor name="gauge" type="strain_gauge" link="link_1" station="0.02" direction="y" '
    'surface="0.001" gain="1" topic="/gauge"/></flexibility>'
)
VERDICTS = {'found', 'doubtful', 'not identifiable'}


@pytest.fixture(scope='module')
def arm() -> Robot:
    return dn.load_robot(ROBOTS / 'one_flexible_link.urdf', gravity=(0, -9.81, 0))


@pytest.fixture(scope='module')
def whole(arm: Robot) -> Recording:
    """Return two seconds of a link that bends, with what gauges would show."""
    source = arm.tree.source.replace('</flexibility>', GAUGE)
    return recorded(dn.load_robot(source, gravity=(0, -9.81, 0)), sweeping(1, 1), 2.0)


def outside(t: Array, draw: np.random.Generator) -> Flags:
    """Return which stamps lie in none of some gaps: inside, at an end, at each other's border."""
    kept = np.ones(len(t), dtype=bool)
    begin = 0.0
    for _ in range(draw.integers(1, 5)):
        begin = draw.choice([0.0, begin, draw.uniform(0.0, t[-1]), t[-1] - 0.2])
        length = draw.choice(LENGTHS)
        kept &= (t < begin) | (t > begin + length)
        begin += length + 0.005 * draw.integers(0, 8)  # some samples, then the next
    return kept


def damaged(whole: Recording, draw: np.random.Generator) -> Recording:
    """Return a recording with gaps in some topics, stamps twice or late, and columns missing."""
    joints = outside(whole.t, draw) if draw.random() < 0.7 else whole.t >= 0.0
    sensors = {}
    for name, (t, raw) in whole.sensors.items():
        kept = np.flatnonzero(outside(t, draw) if draw.random() < 0.7 else t >= 0.0)
        if draw.random() < 0.3:
            kept = kept[: draw.integers(0, 8)]
        if draw.random() < 0.3:
            kept = np.sort(np.concatenate([kept, kept[: len(kept) // 3]]))
        if draw.random() < 0.3:
            kept = draw.permutation(kept)
        sensors[name] = t[kept], raw[kept]
    effort = whole.effort.copy()
    if draw.random() < 0.2:
        effort[draw.integers(0, len(effort)) :] = np.nan
    if draw.random() < 0.1:
        effort[:] = 0.0
    position = whole.position
    velocity = whole.velocity if draw.random() < 0.6 else None
    if draw.random() < 0.15:  # no motion
        position, velocity = 0.0 * position, None
    return replace(
        whole,
        t=whole.t[joints],
        position=position[joints],
        effort=effort[joints],
        velocity=None if velocity is None else velocity[joints],
        sensors=sensors,
    )


@pytest.mark.long_cases('0', '2', '3')
@pytest.mark.parametrize(
    'seed', [*range(4), *(pytest.param(seed, marks=pytest.mark.long) for seed in range(4, 20))]
)
def test_gaps_end_in_a_verdict_or_a_clear_error(arm: Robot, whole: Recording, seed: int) -> None:
    """A bag with gaps of 0.9 s ended in a singular matrix, with a traceback."""
    draw = np.random.default_rng(seed)
    gauge = seed % 3 > 0
    robot = arm
    if gauge:
        source = arm.tree.source.replace('</flexibility>', GAUGE)
        robot = dn.load_robot(source, gravity=(0, -9.81, 0))
    free = FREE if gauge else [path for path in FREE if not path.startswith('sensor.')]
    held_out = float(draw.choice([0.0, 0.25]))
    try:
        found = dn.identify_model(robot, damaged(whole, draw), free, held_out=held_out)
    except dn.DenocError:
        return
    assert set(found.verdict.values()) <= VERDICTS
    for path, verdict in found.verdict.items():
        assert np.isfinite(found.values[path])
        low, high = found.interval[path]
        assert not np.isnan([low, high]).any()
        if verdict == 'found':
            assert np.isfinite([low, high]).all()
