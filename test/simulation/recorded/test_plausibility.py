"""What speaks against a recording: positions that jump, efforts that are no joint torques."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from simulated_bags import SimulatedBag

from denoc_ros.bags.joint_state import JOINT_STATE
from denoc_ros.bags.series import JointSeries, read_joint_states
from denoc_ros.bags.writer import BagWriter
from denoc_ros.cli.main import main
from denoc_ros.estimation.turns import TURN
from denoc_ros.simulation.recorded.plausibility import (
    EffortSizes,
    effort_doubts,
    effort_sums,
    found_jumps,
    gaps_between,
    jump_doubts,
    jumps_between,
)
from denoc_ros.simulation.recorded.replay_bag import Replay, replay_bag
from denoc_ros.simulation.recorded.replay_settings import ReplaySettings
from denoc_ros.simulation.recorded.replay_summary import doubts, notes
from denoc_ros.types import Array

T = 0.01 * np.arange(400, dtype=np.float64)
SWING = np.sin(2.0 * T)


def kinds(q: Array, qd: Array | None = None, angular: bool = True) -> list[tuple[str, float]]:
    """Return kind and time of the jumps of one joint."""
    rates = None if qd is None else qd[:, None]
    jumps = jumps_between(T, q[:, None], rates)
    found = found_jumps(['a'], T, q[:, None], jumps, np.array([angular]))
    return [(jump.kind, round(jump.time, 3)) for _, jump in found]


# ---- positions


@pytest.mark.parametrize('rates', [2.0 * np.cos(2.0 * T), None])
def test_a_smooth_motion_has_no_jump(rates: Array | None) -> None:
    assert kinds(SWING, rates) == []


@pytest.mark.parametrize('rates', [2.0 * np.cos(2.0 * T), None])
def test_a_jump_is_by_turns_a_wild_sample_or_to_another_place(rates: Array | None) -> None:
    turned, wild, put = SWING.copy(), SWING.copy(), SWING.copy()
    turned[100:] += TURN
    wild[200] += 0.8
    put[300:] += 0.8
    assert kinds(turned, rates) == [('turn', 1.0)]
    assert kinds(turned, rates, angular=False) == [('place', 1.0)]
    assert kinds(wild, rates) == [('sample', 2.0), ('sample', 2.01)]
    assert kinds(put, rates) == [('place', 3.0)]


def test_the_way_over_a_gap_is_no_jump() -> None:
    t = np.concatenate([T[:100], T[130:]])
    q = np.sin(2.0 * t)[:, None]
    assert not jumps_between(t, q, None).any()
    assert not gaps_between(t, 0.01).any()
    assert np.flatnonzero(gaps_between(np.concatenate([T[:100], T[160:]]), 0.01)).tolist() == [99]


def test_jumps_of_a_joint_are_one_doubt_for_each_kind() -> None:
    wild = SWING.copy()
    wild[[50, 200, 300]] += 0.8
    found = found_jumps(
        ['a'], T, wild[:, None], jumps_between(T, wild[:, None], None), np.array([True])
    )
    (doubt,) = jump_doubts([jump for _, jump in found])
    assert doubt == (
        'a: position must be without wild samples, got 6 jumps, the first by 0.8'
        + doubt.partition('by 0.8')[2]
    )
    assert doubt.endswith('at 0.500 s')


# ---- efforts


def sizes(effort: Array, expected: Array, gravity: Array | None = None) -> EffortSizes:
    gravity = np.zeros_like(expected) if gravity is None else gravity
    columns = (each[:, None] for each in (effort, expected, gravity))
    return EffortSizes.of_sums(effort_sums(*columns), None)


def torque() -> Array:
    draw = np.random.default_rng(3)
    return np.asarray(4.0 + 3.0 * SWING + 0.1 * draw.standard_normal(len(T)))


def test_an_effort_near_the_model_s_torque_is_one() -> None:
    for effort in (torque(), 0.7 * torque(), 1.5 * torque(), torque() + 1.0, torque() - 3.0):
        assert effort_doubts(['a'], sizes(effort, torque())) == []


@pytest.mark.parametrize('factor', [1.0 / 12.0, 30.0, -1.0])
def test_a_multiple_of_the_torque_is_a_current(factor: float) -> None:
    found = effort_doubts(['a'], sizes(factor * torque(), torque()))
    if factor > 0.0:
        assert found == [
            f'a: effort must be the torque of the joint, got about {factor:.3g} times that of the '
            'model: a current, or another unit'
        ]
    assert len(found) == 1


def test_an_effort_that_vanishes_is_none_unless_the_torque_does() -> None:
    assert 'got 0 where the model has' in effort_doubts(['a'], sizes(0.0 * T, torque()))[0]
    assert effort_doubts(['a'], sizes(0.0 * T, 0.0 * T)) == []
    assert effort_doubts(['a'], sizes(0.0 * T, 1e-12 * torque())) == []
    assert effort_doubts(['a'], sizes(np.nan * T, torque())) == []


# ---- the replay


def rewritten(series: JointSeries, path: Path, effort: Array, position: Array) -> Path:
    """Write joint states with other efforts and positions."""
    with BagWriter(path) as bag:
        bag.add_topic('/joint_states', JOINT_STATE)
        for k, stamp_ns in enumerate(series.stamp_ns.tolist()):
            bag.write_message(
                '/joint_states', stamp_ns, name=list(series.names), position=position[k],
                velocity=series.velocity[k], effort=effort[k],
            )  # fmt: skip
    return path


@pytest.fixture(scope='module')
def measured(simulated_bag: SimulatedBag) -> JointSeries:
    return read_joint_states(simulated_bag.path)


def replayed(
    simulated: SimulatedBag, path: Path, series: JointSeries, effort: Array, fit: bool
) -> Replay:
    bag = rewritten(series, path / 'run.mcap', effort, series.position)
    return replay_bag(bag, simulated.robot, None, ReplaySettings(fit_friction=fit))


@pytest.mark.parametrize('fit', [False, True])
def test_what_is_no_torque_is_doubted_with_and_without_fitted_friction(
    simulated_bag: SimulatedBag, measured: JointSeries, tmp_path: Path, fit: bool
) -> None:
    robot = simulated_bag.robot
    states = np.zeros((3, len(measured.t), robot.n))
    states[0][:, robot.joint_indices] = measured.select(robot.joint_names).position
    gravity = robot.inverse_dynamics(*states)[:, robot.joint_indices]
    whole = replayed(simulated_bag, tmp_path, measured, measured.effort, fit)
    assert doubts(whole) == []
    for name, effort in {
        'current': measured.effort / 12.0,
        'zero': 0.0 * measured.effort,
        'compensated': measured.effort - gravity,
    }.items():
        folder = tmp_path / name
        folder.mkdir()
        found = doubts(replayed(simulated_bag, folder, measured, effort, fit))
        for joint in measured.names:
            assert any(text.startswith(f'{joint}: effort must be') for text in found), name


def test_wild_samples_and_turns_are_doubts_and_another_place_is_a_note(
    simulated_bag: SimulatedBag, measured: JointSeries, tmp_path: Path
) -> None:
    position = measured.position.copy()
    position[100, 0] += 0.4
    position[200:, 1] += TURN
    position[300:, 0] += 0.5
    bag = rewritten(measured, tmp_path / 'run.mcap', measured.effort, position)
    found = replay_bag(bag, simulated_bag.robot)
    first, second = doubts(found)
    assert first.startswith('joint_1: position must be without wild samples, got 2 jumps')
    assert second.startswith('joint_2: position must be without jumps by a turn')
    (note,) = notes(found)
    assert note.startswith('the robot was put elsewhere 1 times, first joint_1 by 0.5')


@pytest.mark.parts('reports')
def test_the_verb_ends_with_status_2_and_the_reason(
    simulated_bag: SimulatedBag,
    measured: JointSeries,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    robot = tmp_path / 'robot.urdf'
    robot.write_text(simulated_bag.robot.tree.source)
    bag = rewritten(measured, tmp_path / 'run.mcap', measured.effort / 12.0, measured.position)
    command = ['replay', str(bag), '--robot', str(robot), '--gravity', '0', '-9.81', '0']
    command += ['--no-output', '--report', str(tmp_path / 'page.html'), '--fit-friction', '--json']
    assert main(command) == 2
    found = json.loads(capsys.readouterr().out)['doubts']
    assert any('a current, or another unit' in text for text in found)
