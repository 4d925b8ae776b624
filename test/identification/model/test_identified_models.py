"""The whole model from recordings whose truth is known."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from identification_runs import recorded, sweeping

import denoc_ros as dn
from denoc_ros.dynamics.parameter_columns import INERTIAL
from denoc_ros.dynamics.robot import Robot
from denoc_ros.identification.model.free_parameters import FreeParameters, SearchPoint
from denoc_ros.identification.model.information import verdict_of
from denoc_ros.identification.model.model_fit import IdentifiedModel, with_far_starts
from denoc_ros.identification.model.model_result import (
    applied_description,
    not_applied,
    result_of,
    verdict_text,
)
from denoc_ros.identification.model.prediction import PreparedRun
from denoc_ros.identification.model.search import ModelSearch
from denoc_ros.model.payloads import carrying_links
from denoc_ros.model.tree import RigidInertia
from denoc_ros.types import Array

ROBOTS = Path(__file__).resolve().parents[3] / 'config' / 'robots'


@pytest.fixture(scope='module')
def arm() -> Robot:
    robot = dn.load_robot(ROBOTS / 'canadarm_gauges.urdf', gravity=(0, 0, 0))
    return robot.with_overrides({'payload.tool.mass': 100.0})


@pytest.fixture(scope='module')
def found(arm: Robot) -> IdentifiedModel:
    """Return what is found of an arm that is not as its model says."""
    true = arm.with_overrides(TRUTH)
    run = recorded(true, sweeping(3, 1), 6.0)
    return dn.identify_model(arm, run, ['beam.*.ei', 'payload.tool.mass', 'sensor.*root.gain'])


TRUTH = {
    'beam.link_1.y.ei': 1.3e5,
    'beam.link_2.y.ei': 1.4e5,
    'payload.tool.mass': 125.0,
    'sensor.link_1_y_root.gain': 0.9,
    'sensor.link_2_y_root.gain': 1.15,
}


@pytest.mark.parametrize('path', TRUTH)
def test_what_is_found_is_the_truth(found: IdentifiedModel, path: str) -> None:
    assert found.verdict[path] == 'found'
    # noise of 0.2 % and the motion between samples leave some 0.1 %
    assert found.values[path] == pytest.approx(TRUTH[path], rel=5e-3)
    low, high = found.interval[path]
    assert low < found.values[path] < high
    assert high - low < 0.02 * TRUTH[path]


def test_held_out_part_is_explained_and_the_robot_has_the_numbers(found: IdentifiedModel) -> None:
    assert not found.combinations
    assert not found.reasons
    for channel in found.channels:
        assert channel.held_out_after < 0.2 * channel.held_out_before, channel
    assert found.robot.tree.bodies[0].beam is not None
    assert found.robot.tree.bodies[0].beam.y is not None
    assert found.robot.tree.bodies[0].beam.y.stiffness == found.values['beam.link_1.y.ei']


def test_what_nothing_shows_is_never_found(arm: Robot) -> None:
    # gauges alone, joints that move as they were told: friction shows nowhere
    true = arm.with_overrides({'beam.link_1.y.ei': 1.2e5})
    run = recorded(true, sweeping(3, 2), 3.0)
    blind = np.full_like(run.effort, np.nan)
    gauges = {'link_2_y_middle': run.sensors['link_2_y_middle']}
    seen = dn.Recording(run.t, run.joints, run.position, blind, run.velocity, gauges, 'gauge')
    free = ['sensor.link_2_y_middle.gain', 'beam.link_2.y.ei', 'joint.joint_1.friction']
    found = dn.identify_model(arm, seen, free, held_out=0.0)
    assert found.verdict['joint.joint_1.friction'] == 'not identifiable'
    assert found.interval['joint.joint_1.friction'] == (0.0, np.inf)
    assert 'nothing is seen of joint.joint_1.friction' in found.combinations


def test_only_ratios_of_a_body_and_a_gain_of_its_torque_are_seen() -> None:
    pendulum = dn.load_robot(ROBOTS / 'rigid_pendulum.urdf')
    run = recorded(pendulum, sweeping(pendulum.n, 3), 4.0)
    link = pendulum.tree.bodies[0].name
    joint = pendulum.joint_names[0]
    free = [f'link.{link}.inertial', f'effort.{joint}.gain', 'joint.*.damping', 'joint.*.friction']
    found = dn.identify_model(pendulum, run, free)
    assert found.verdict[f'link.{link}.mass'] == 'not identifiable'
    assert found.verdict[f'effort.{joint}.gain'] == 'not identifiable'
    assert any(f'effort.{joint}.gain' in line for line in found.combinations)


def test_torque_of_a_rigid_arm_is_predicted_by_its_identified_bodies() -> None:
    arm = dn.load_robot(ROBOTS / 'puma.urdf')
    free = ['link.*.inertial', 'joint.*.friction']
    parameters = FreeParameters(arm, free)
    theta = np.random.default_rng(4).normal(0.0, 0.2, parameters.size)
    true = parameters.robot_at(parameters.settings(theta))
    run = recorded(true, sweeping(arm.n, 5), 5.0)
    found = dn.identify_model(arm, run, free)
    other = recorded(true, sweeping(arm.n, 6), 4.0, noise=0.0)
    states = np.zeros((3, len(other.t), arm.n))
    states[0], states[1] = other.position, other.velocity
    states[2] = np.random.default_rng(7).normal(0.0, 1.0, states[2].shape)
    wanted = true.inverse_dynamics(*states)
    error = np.abs(found.robot.inverse_dynamics(*states) - wanted).max(axis=0)
    before = np.abs(arm.inverse_dynamics(*states) - wanted).max(axis=0)
    assert (error < 0.15 * before).all()
    # every body of the search can exist
    for name in {path.split('.')[1] for path in found.values if path.startswith('link.')}:
        ten = np.array([found.values[f'link.{name}.{each}'] for each in INERTIAL])
        assert ten[0] > 0.0


def test_an_imu_that_was_not_recorded_changes_nothing(arm: Robot) -> None:
    run = recorded(arm, sweeping(3, 1), 1.0)
    imu = '<sensor name="imu" type="imu" link="link_2" station="3" topic="imu"/></flexibility>'
    source = arm.tree.source.replace('</flexibility>', imu)
    other = dn.load_robot(source, gravity=(0, 0, 0)).with_overrides(arm.tree.overrides)
    point = SearchPoint()
    rows = [
        np.concatenate(PreparedRun(run, robot, 20.0, 2e-3).residuals(robot, point))
        for robot in (arm, other)
    ]
    np.testing.assert_array_equal(rows[0], rows[1])


def test_bodies_that_were_found_are_written_into_the_description() -> None:
    arm = dn.load_robot(ROBOTS / 'puma.urdf').with_overrides({'payload.tool.mass': 2.0})
    run = recorded(arm, sweeping(arm.n, 5), 1.0)
    found = dn.identify_model(arm, run, ['link.link_2.inertial'], held_out=0.0)
    heavier = {'link_2': RigidInertia(1.5, np.array([0.3, 0.0, 0.15]), np.diag([0.1, 0.2, 0.2]))}
    told = dict.fromkeys(found.verdict, 'found')
    known = replace(found, bodies=heavier, verdict=told)
    text = applied_description(ROBOTS / 'puma.urdf', known)
    assert not not_applied(known)
    written, before = (dn.load_robot(source) for source in (text, ROBOTS / 'puma.urdf'))
    hung = before.copy()
    hung.set_payload('link_2', *centred(heavier['link_2']))
    q = np.random.default_rng(1).normal(size=(4, arm.n))
    wanted = hung.inertia_matrix(q)
    np.testing.assert_allclose(written.inertia_matrix(q), wanted, rtol=0, atol=1e-9 * wanted.max())


def test_a_payload_that_was_found_is_written_into_the_description() -> None:
    """The numbers of the load that were not free are those of the search."""
    source = ROBOTS / 'puma.urdf'
    load = {'payload.tool.mass': 2.0, 'payload.tool.com': [0.0, 0.05, 0.1]}
    arm = dn.load_robot(source).with_overrides(load)
    run = recorded(arm, sweeping(arm.n, 5), 1.0)
    start = arm.with_overrides({'payload.tool.mass': 1.5})
    found = dn.identify_model(start, run, ['payload.tool.mass'], held_out=0.0)
    assert found.verdict['payload.tool.mass'] == 'found'
    text = applied_description(source, found)
    assert '<payload link="tool"' in text
    written, wanted = (
        dn.load_robot(text),
        dn.load_robot(source).with_overrides(
            load | {'payload.tool.mass': found.values['payload.tool.mass']}
        ),
    )
    q = np.random.default_rng(1).normal(size=(4, arm.n))
    np.testing.assert_array_equal(written.inertia_matrix(q), wanted.inertia_matrix(q))


def test_what_is_not_identifiable_is_not_written_into_the_description() -> None:
    """An upper arm of 12.93 kg became one of 114 kg, "with what was found"."""
    arm = dn.load_robot(ROBOTS / 'puma.urdf').with_overrides({'payload.tool.mass': 2.0})
    run = recorded(arm, sweeping(arm.n, 5), 1.0)
    free = ['link.link_2.inertial', 'joint.joint_2.friction']
    found = dn.identify_model(arm, run, free, held_out=0.0)
    assert 'not identifiable' in [v for p, v in found.verdict.items() if p.startswith('link.')]
    text = applied_description(ROBOTS / 'puma.urdf', found)
    written, before = (dn.load_robot(source) for source in (text, ROBOTS / 'puma.urdf'))
    q = np.random.default_rng(1).normal(size=(4, arm.n))
    np.testing.assert_array_equal(written.inertia_matrix(q), before.inertia_matrix(q))
    left_out = not_applied(found)
    assert 'link.link_2.inertial' in left_out
    assert all(found.verdict.get(path, 'not identifiable')[0] == 'n' for path in left_out)


def test_a_load_of_set_payload_is_part_of_the_payload_that_is_identified() -> None:
    """It counted as fixed: of 1.736 kg in all, 0.101 kg were found."""
    truth = dn.load_robot(ROBOTS / 'two_link_rr.urdf', gravity=(0.0, -9.81, 0.0))
    link = truth.tree.bodies[-1].name
    centre = [0.2, 0.1, 0.0]
    truth = truth.with_overrides({f'payload.{link}.mass': 1.736, f'payload.{link}.com': centre})
    run = recorded(truth, sweeping(truth.n, 3), 2.0)
    for load in (1.2, 2.6):  # below and above the truth
        robot = dn.load_robot(ROBOTS / 'two_link_rr.urdf', gravity=(0.0, -9.81, 0.0))
        robot.set_payload(link, load, centre)
        found = dn.identify_model(robot, run, [f'payload.{link}.mass'], held_out=0.0)
        path = f'payload.{link}.mass'
        np.testing.assert_allclose(found.start[path], load, rtol=1e-12)
        assert found.verdict[path] == 'found'
        np.testing.assert_allclose(found.values[path], 1.736, rtol=2e-3)
        assert robot.payload_mass(link) == load  # the caller's robot stays as it was


def test_payloads_become_numbers_of_the_model_with_the_same_dynamics() -> None:
    rng = np.random.default_rng(6)
    robot = dn.load_robot(ROBOTS / 'canadarm_rrr.urdf')
    links = carrying_links(robot.tree)[-2:]
    own = f'payload.{links[0]}'
    robot = robot.with_overrides({f'{own}.mass': 3.0, f'{own}.com': [0.1, 0, 0]})
    for link in links:
        part = rng.normal(size=(3, 3))
        second = part @ part.T  # integral of r r^T, of which a body's inertia is made
        inertia = np.trace(second) * np.eye(3) - second
        robot.set_payload(link, 2.0, rng.normal(size=3), inertia)
    modelled = robot.with_modelled_payloads()
    loads = modelled.tree.payloads
    assert all(modelled.payload_mass(link) == loads[link].mass for link in links)
    q = 0.1 * rng.normal(size=(3, robot.n))
    wanted = robot.inertia_matrix(q[0])
    np.testing.assert_allclose(
        modelled.inertia_matrix(q[0]), wanted, rtol=0, atol=1e-10 * np.abs(wanted).max()
    )
    np.testing.assert_allclose(
        modelled.inverse_dynamics(*q), robot.inverse_dynamics(*q), rtol=1e-9
    )
    assert dn.load_robot(ROBOTS / 'canadarm_rrr.urdf').with_modelled_payloads()._payloads == {}


def test_verdicts_are_by_the_number_itself_or_by_a_size_that_is_said() -> None:
    """A damping of a hundredth of its joint's torque was found, 0.1 to 14.8 times the truth."""
    truth = dn.load_robot(ROBOTS / 'two_link_rr.urdf', gravity=(0.0, -9.81, 0.0))
    joint = truth.joint_names[0]
    truth = truth.with_overrides({f'joint.{joint}.damping': 1e-4})
    run = recorded(truth, sweeping(truth.n, 3), 1.0)
    size = 0.01 * np.abs(run.effort).max()
    noise = size * np.random.default_rng(1).normal(size=run.effort.shape)
    free = ['joint.*.damping', 'effort.*.offset']
    found = dn.identify_model(truth, replace(run, effort=run.effort + noise), free, held_out=0.0)
    for path, verdict in found.verdict.items():
        low, high = found.interval[path]
        half = 0.5 * (high - low)
        if path.endswith('damping'):
            assert found.size[path] == abs(found.values[path])
            share = 0.5 * np.log(high / low) if low > 0.0 else np.inf
        else:
            share = half / found.size[path]
        assert verdict == verdict_of(share)
    assert found.verdict[f'joint.{joint}.damping'] == 'not identifiable'
    rows = {one['path']: one for one in result_of(found)['parameters']}
    said = verdict_text(rows[f'effort.{joint}.offset'])
    assert said.endswith('N m or N')
    assert '±' in said
    assert verdict_text(rows[f'joint.{joint}.damping']) == 'not identifiable'


def centred(body: RigidInertia) -> tuple[float, Array, Array]:
    """Return mass, centre of mass (3,) and the inertia (3, 3) about it."""
    c = body.first_moment / body.mass
    shift = body.mass * (float(c @ c) * np.eye(3) - np.outer(c, c))
    return body.mass, c, body.inertia - shift


def test_numbers_that_torque_is_linear_in_have_the_slopes_of_differences() -> None:
    arm = dn.load_robot(ROBOTS / 'puma.urdf')
    parameters = FreeParameters(arm, ['link.*.inertial'])
    theta = np.random.default_rng(8).normal(0.0, 0.3, parameters.size)
    places, paths = parameters.linear(set(arm.joint_names))
    robot = parameters.robot_at(parameters.settings(theta))
    states = np.random.default_rng(9).normal(0.0, 1.0, (3, arm.n))
    q, qd, qdd = states
    slopes = robot.torque_regressor(q, qd, qdd, paths) @ parameters.slopes(theta)[places]
    step = 1e-5
    for k in range(0, parameters.size, 7):
        change = np.zeros(parameters.size)
        change[k] = step
        sides = [
            parameters.robot_at(parameters.settings(theta + side * change)).inverse_dynamics(
                q, qd, qdd
            )
            for side in (1.0, -1.0)
        ]
        difference = (sides[0] - sides[1]) / (2.0 * step)
        np.testing.assert_allclose(slopes[:, k], difference, atol=1e-7 * np.abs(slopes).max())


FINGERS = """<link name="{0}"><inertial><mass value="0.1"/><origin xyz="0.1 0 0"/>
<inertia ixx="1e-4" ixy="0" ixz="0" iyy="1e-4" iyz="0" izz="1e-4"/></inertial></link>
<joint name="{0}_joint" type="prismatic"><parent link="link_6"/><child link="{0}"/>
<axis xyz="0 1 0"/><limit lower="0" upper="0.1" effort="20" velocity="1"/>{1}</joint>"""


def test_fingers_that_are_not_recorded_leave_torque_linear() -> None:
    """With a gripper in the URDF, two runs of seven joints at 250 Hz took ten minutes."""
    text = (ROBOTS / 'puma.urdf').read_text(encoding='utf-8')
    fingers = FINGERS.format('left', '') + FINGERS.format('right', '<mimic joint="left_joint"/>')
    arm = dn.load_robot(text.replace('</robot>', f'{fingers}</robot>'))
    joints = arm.joint_names[:6]
    t = np.arange(0.0, 0.6, 0.01)
    q = np.sin(np.outer(t, np.arange(1.0, 7.0)))
    run = dn.Recording(t, joints, q, np.cos(q) + 0.1 * q[:, ::-1])
    free = ['link.link_3.inertial', 'link.left.inertial', 'joint.joint_2.damping']
    recordings = [run, replace(run, name='again')]
    parameters = FreeParameters(arm, free, {}, {}, [each.name for each in recordings])
    search = ModelSearch([PreparedRun(each, arm, 10.0, 1e-3) for each in recordings], parameters)
    zero = np.zeros(parameters.size)
    before = search.evaluations
    found = search.jacobian(zero)
    assert search.evaluations - before <= 3  # not one a number
    step, scale = 1e-4, np.abs(found).max()
    for k in range(0, parameters.size, 4):
        change = np.eye(parameters.size)[k] * step
        sides = [search.whitened(zero + side * change) for side in (1.0, -1.0)]
        difference = (sides[0] - sides[1]) / (2.0 * step)
        np.testing.assert_allclose(found[:, k], difference, atol=1e-5 * scale)
    assert parameters.linear({*joints, 'left_joint'}) == ([], [])


@pytest.mark.parametrize(
    ('free', 'says'),
    [
        (['beam.nowhere.y.ei'], "--free 'beam.nowhere.y.ei' must be of one of"),
        ([], '--free must name what is free, got nothing'),
    ],
)
def test_paths_of_nothing_are_refused(arm: Robot, free: list[str], says: str) -> None:
    run = recorded(arm, sweeping(3, 1), 0.5)
    with pytest.raises(dn.ConfigError, match=says.replace('(', r'\(')):
        dn.identify_model(arm, run, free)


def test_recordings_that_cannot_be_are_refused(arm: Robot) -> None:
    t, zero = np.arange(60.0), np.zeros((60, 3))
    joints = tuple(arm.joint_names)
    with pytest.raises(dn.IdentificationError, match='stamps must rise'):
        dn.Recording(t[::-1].copy(), joints, zero, zero)
    with pytest.raises(dn.IdentificationError, match='at least 50 joint states, got 10'):
        dn.Recording(t[:10], joints, zero[:10], zero[:10])
    with pytest.raises(dn.IdentificationError, match='effort must have shape'):
        dn.Recording(t, joints, zero, zero[:, :2])
    with pytest.raises(dn.IdentificationError, match='positions must be finite'):
        dn.Recording(t, joints, zero + np.nan, zero)
    silent = dn.Recording(t, joints, zero, zero + np.nan)
    with pytest.raises(dn.IdentificationError, match='measured effort or sensors'):
        dn.identify_model(arm, silent, ['beam.*.ei'])


@pytest.fixture(scope='module')
def two_runs() -> tuple[Robot, list[dn.Recording]]:
    """Return an arm, and two runs whose effort is off by as much either way."""
    arm = dn.load_robot(ROBOTS / 'two_link_rr.urdf', gravity=(0.0, -9.81, 0.0))
    numbers = {'damping': 1.0, 'friction': 0.5}
    true = arm.with_overrides(
        {f'joint.{name}.{term}': v for name in arm.joint_names for term, v in numbers.items()}
    )
    runs = [recorded(true, sweeping(2, k + 1), 4.0, noise=0.01, seed=k) for k in range(2)]
    off = (-DRIFT, DRIFT)
    return arm, [replace(run, effort=run.effort + by) for run, by in zip(runs, off, strict=True)]


DRIFT = 5.0  # N m
FRICTION = ['joint.*.damping', 'joint.*.friction', 'effort.*.offset']


def test_runs_together_are_no_worse_than_alone(
    two_runs: tuple[Robot, list[dn.Recording]],
) -> None:
    """One offset for both followed one of them: of 0.13 N m one channel left 10."""
    arm, runs = two_runs
    alone = [dn.identify_model(arm, run, FRICTION, held_out=0.0) for run in runs]
    both = dn.identify_model(arm, runs, FRICTION, held_out=0.0)
    assert not both.reasons
    apart = [channel for one in alone for channel in one.channels]
    for one, together in zip(apart, both.channels, strict=True):
        assert together.after < 1.05 * one.after
        assert together.alone > 0.95
    for joint in arm.joint_names:
        for run, drift in (('truth', -DRIFT), ('truth (2)', DRIFT)):
            path = f'effort.{joint}.offset[{run}]'
            assert both.verdict[path] == 'found'
            assert both.values[path] == pytest.approx(drift, abs=0.05)
            low, high = both.interval[path]
            assert low < drift < high
    # the search is about as long as those of both runs
    assert both.evaluations <= sum(one.evaluations for one in alone)


def test_runs_that_do_not_agree_are_named(two_runs: tuple[Robot, list[dn.Recording]]) -> None:
    """A friction that differs between runs made both worse, without a word."""
    arm, runs = two_runs
    rough = arm.joint_names[-1]
    true = arm.with_overrides(
        {
            f'joint.{n}.{t}': v
            for n in arm.joint_names
            for t, v in (('damping', 1), ('friction', 1))
        }
    )
    other = recorded(true, sweeping(2, 2), 4.0, noise=0.01, seed=1)
    found = dn.identify_model(arm, [runs[0], other], FRICTION, held_out=0.0)
    told = [reason for reason in found.reasons if 'must agree' in reason]
    assert told
    assert any(f'effort {rough}' in reason for reason in told)
    assert 'found' not in found.verdict.values()
    rows = result_of(found)['channels']
    assert min(row['rms_alone'] / row['rms_after'] for row in rows) < 0.8


def test_an_offset_of_each_run_is_written_as_their_mean() -> None:
    arm = dn.load_robot(ROBOTS / 'canadarm_gauges.urdf', gravity=(0, 0, 0))
    free = ['sensor.link_1_y_root.offset', 'sensor.link_1_y_root.gain', 'effort.*.offset']
    parameters = FreeParameters(arm, free, runs=['a.mcap', 'b.mcap'])
    offsets = [f'sensor.link_1_y_root.offset[{run}]' for run in ('a.mcap', 'b.mcap')]
    assert [path for path in parameters.paths if path.startswith('sensor.')][:2] == offsets
    assert parameters.is_sensor_offset.sum() == 2
    theta = parameters.point({offsets[0]: 2e-5, offsets[1]: 4e-5})
    point = parameters.settings(theta)
    for run, value in (('a.mcap', 2e-5), ('b.mcap', 4e-5)):
        own = point.of_run(run).channels['sensor.link_1_y_root.offset']
        assert own == pytest.approx(value)
    written = parameters.overrides(point)
    assert written['sensor.link_1_y_root.offset'] == pytest.approx(3e-5)
    # derivatives of the numbers are those of differences
    step, slopes = 1e-6, parameters.slopes(theta)
    for k in range(parameters.size):
        change = step * np.eye(parameters.size)[k]
        sides = parameters.values(theta + change) - parameters.values(theta - change)
        np.testing.assert_allclose(slopes[:, k], sides / (2 * step), rtol=1e-6, atol=1e-9)


def test_far_start_is_a_reason_where_the_stiffness_is_not_found(found: IdentifiedModel) -> None:
    lost, kept = 'beam.link_1.y.ei', 'beam.link_2.y.ei'
    led = {lost: 2e4, kept: 2e4}
    told = with_far_starts(replace(found, verdict={**found.verdict, lost: 'doubtful'}), led)
    assert len(told.reasons) == 1
    assert told.reasons[0].startswith(f'{lost}: search must begin within a factor of 2.7')
    assert told.verdict[kept] == 'found'
