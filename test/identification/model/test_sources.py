"""Recordings out of tables: columns, windows, filters that sensors stand behind, offsets."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from identification_runs import recorded, sweeping
from scipy.signal import lsim

import denoc_ros as dn
from denoc_ros.bags.joint_state import JOINT_STATE, JointStateMessage
from denoc_ros.bags.writer import BagWriter
from denoc_ros.identification.model.free_parameters import FreeParameters
from denoc_ros.identification.model.search import ModelSearch
from denoc_ros.identification.model.sources import RecordingSettings, SensorFilter, read_source

ROBOTS = Path(__file__).resolve().parents[3] / 'config' / 'robots'
FILTER = SensorFilter(12.566, 0.9)  # 2 Hz


@pytest.fixture(scope='module')
def rig() -> dn.Robot:
    return dn.load_robot(ROBOTS / 'two_flexible_links.urdf', gravity=(0, 0, 0))


def table(path: Path, **columns: np.ndarray) -> Path:
    values = np.column_stack(list(columns.values()))
    np.savetxt(path, values, delimiter=',', header=','.join(columns), comments='')
    return path


def swings(rows: int = 200) -> dict[str, np.ndarray]:
    t = 0.01 * np.arange(rows)
    return {'time': t, 'hub': np.sin(t), 'joint_2': np.cos(t), 'bend': 0.01 * np.sin(3.0 * t)}


@pytest.mark.parametrize('jitter', [0.0, 0.3])
def test_values_behind_a_filter_are_those_of_its_differential_equation(jitter: float) -> None:
    draw = np.random.default_rng(1)
    t = np.cumsum(0.002 * (1.0 + jitter * draw.uniform(-1.0, 1.0, 1500)))
    values = 0.3 + np.sin(9.0 * t) - np.sin(9.0 * t[0])
    w, z = FILTER.omega, FILTER.damping
    even = np.linspace(t[0], t[-1], 20001)
    fine = 0.3 + np.sin(9.0 * even) - np.sin(9.0 * t[0])
    _, wanted, _ = lsim(([w * w], [1.0, 2.0 * z * w, w * w]), fine - 0.3, even - t[0])
    # linear between stamps 2 ms apart: (9 * 0.002)^2 / 8 of the amplitude, and the grid's as much
    found = FILTER.passed(t, values)
    np.testing.assert_allclose(found, np.interp(t, even, 0.3 + wanted), rtol=0, atol=5e-4)
    still = FILTER.passed(t, np.full_like(t, 0.3))
    np.testing.assert_allclose(still, 0.3, rtol=0, atol=1e-9)


@pytest.mark.long
def test_stiffness_is_found_from_filtered_readings_if_the_filter_is_known(rig: dn.Robot) -> None:
    path = 'beam.link_1.y.ei'
    truth = {path: 3.5}
    run = recorded(rig.with_overrides(truth), sweeping(2, 3), 3.0)
    behind = {name: (t, FILTER.passed(t, raw)) for name, (t, raw) in run.sensors.items()}
    gauges = replace(run, sensors=behind, effort=np.full_like(run.effort, np.nan))
    known = replace(gauges, filters=dict.fromkeys(behind, FILTER))
    found = dn.identify_model(rig, known, [path], held_out=0.0)
    assert found.verdict[path] == 'found'
    assert found.values[path] == pytest.approx(truth[path], rel=0.01)
    unknown = dn.identify_model(rig, gauges, [path], held_out=0.0)
    assert unknown.verdict[path] != 'found'


def test_an_offset_of_measured_effort_is_told_from_gravity() -> None:
    pendulum = dn.load_robot(ROBOTS / 'rigid_pendulum.urdf')
    run = recorded(pendulum.with_overrides({'payload.link_1.mass': 0.2}), sweeping(1, 3), 3.0)
    shifted = replace(run, effort=run.effort + 0.1)
    free = ['payload.link_1.mass', 'effort.joint_1.offset']
    found = dn.identify_model(pendulum, shifted, free)
    assert found.values['effort.joint_1.offset'] == pytest.approx(0.1, abs=2e-3)
    low, high = found.interval['effort.joint_1.offset']
    assert low < found.values['effort.joint_1.offset'] < high
    assert not found.reasons


def test_a_payload_of_a_light_robot_starts_light(rig: dn.Robot) -> None:
    parameters = FreeParameters(rig, ['payload.tip_mass.mass'])
    # a tenth of 0.83 kg: an error of 50 g must not count as 5 % of a kilogram
    assert parameters.values(np.zeros(1)) == pytest.approx(0.0834, rel=0.01)
    assert parameters.scales(np.zeros(1)) == pytest.approx(0.0834, rel=0.01)


def test_columns_of_a_table_become_joints_and_sensors(rig: dn.Robot, tmp_path: Path) -> None:
    given = swings()
    given['bend'][7] = np.nan
    columns = {'joint_1.position': 'hub', 'sensor.strain_2': 'bend'}
    settings = RecordingSettings(columns=columns, begin=0.5, end=1.5)
    run = read_source(table(tmp_path / 'run.csv', **given), rig, settings)
    assert run.joints == ('joint_1', 'joint_2')
    inside = (given['time'] >= 0.5) & (given['time'] <= 1.5)
    np.testing.assert_allclose(run.t, given['time'][inside])
    np.testing.assert_allclose(run.position[:, 0], given['hub'][inside])
    np.testing.assert_allclose(run.position[:, 1], given['joint_2'][inside])
    assert run.velocity is None
    assert np.isnan(run.effort).all()
    t, raw = run.sensors['strain_2']
    np.testing.assert_allclose(t, given['time'][inside])
    np.testing.assert_allclose(raw, given['bend'][inside])
    assert list(run.sensors) == ['strain_2']
    whole = read_source(tmp_path / 'run.csv', rig, RecordingSettings(columns=columns))
    assert len(whole.sensors['strain_2'][0]) == len(whole.t) - 1  # without the NaN


def test_load_cell_reads_its_component_of_wrenches_in_a_bag(tmp_path: Path) -> None:
    cell = (
        '<sensor name="cell" type="load_cell" link="link_2" station="0.1" direction="y"'
        ' component="moment" topic="wrench"/></flexibility>'
    )
    text = (ROBOTS / 'two_flexible_links.urdf').read_text()
    rig = dn.load_robot(text.replace('</flexibility>', cell), gravity=(0, 0, 0))
    encoder = JointStateMessage(list(rig.joint_names), ['position'])
    with BagWriter(tmp_path / 'run.mcap') as bag:
        bag.add_topic('/joint_states', JOINT_STATE)
        bag.add_topic('/wrench', 'geometry_msgs/msg/WrenchStamped')
        for k in range(60):
            stamp = 10**7 * (k + 1)
            bag.write('/joint_states', stamp, encoder.encode(stamp, np.full(2, 0.01 * k)))
            torque = {'x': 1.0, 'y': 2.0, 'z': 0.5 * k}
            bag.write_message('/wrench', stamp, wrench={'torque': torque})
    t, raw = read_source(tmp_path / 'run.mcap', rig).sensors['cell']
    np.testing.assert_allclose(raw, 50.0 * t, atol=1e-9)


def test_joints_of_a_bag_are_renamed(rig: dn.Robot, tmp_path: Path) -> None:
    encoder = JointStateMessage(['arm_1', 'arm_2'], ['position'])
    with BagWriter(tmp_path / 'run.mcap') as bag:
        bag.add_topic('/joint_states', JOINT_STATE)
        for k in range(60):
            stamp = 1_000_000_000 + 10_000_000 * k
            bag.write('/joint_states', stamp, encoder.encode(stamp, np.array([0.1 * k, -0.2 * k])))
    settings = RecordingSettings(rename={'arm_': 'joint_'})
    run = read_source(tmp_path / 'run.mcap', rig, settings)
    assert run.joints == ('joint_1', 'joint_2')
    np.testing.assert_allclose(run.position[9], [0.9, -1.8])


@pytest.mark.parametrize(
    ('settings', 'says'),
    [
        (RecordingSettings(), 'table must have the position of a joint'),
        (RecordingSettings(columns={'sensor.none': 'bend'}), 'must be a sensor of the robot'),
        (RecordingSettings(columns={'joint_1.position': 'none'}), 'must be one of time, hub'),
        (
            RecordingSettings(columns={'joint_1.position': 'hub'}, filters={'none': FILTER}),
            r'--filter must be of a sensor of the robot \(strain_1, strain_2\), got none',
        ),
    ],
)
def test_names_of_nothing_are_refused(
    rig: dn.Robot, tmp_path: Path, settings: RecordingSettings, says: str
) -> None:
    given = swings()
    del given['joint_2']
    path = table(tmp_path / 'run.csv', **given)
    with pytest.raises(dn.BagError, match=says):
        read_source(path, rig, settings)


def test_columns_of_a_bag_and_filters_that_cannot_be_are_refused(
    rig: dn.Robot, tmp_path: Path
) -> None:
    with pytest.raises(dn.BagError, match='--column must come with a table, got a bag'):
        read_source(tmp_path / 'run.mcap', rig, RecordingSettings(columns={'joint_1.x': 'y'}))
    with pytest.raises(dn.IdentificationError, match='damping must be > 0, got 0'):
        SensorFilter(10.0, 0.0)


def test_a_swing_without_effort_tells_ratios_and_no_scale() -> None:
    pendulum = dn.load_robot(ROBOTS / 'rigid_pendulum.urdf', gravity=(0, -9.81, 0))
    run = swing(pendulum)
    free = ['joint.joint_1.damping', 'link.link_1.inertial']
    heavier = {'payload.link_1.mass': 0.03, 'payload.link_1.com': [0.33, 0.0, 0.0]}
    found = dn.identify_model(pendulum.with_overrides(heavier), run, free, held_out=0.0)
    for path in ('joint.joint_1.damping', 'link.link_1.first_moment.x', 'link.link_1.inertia.izz'):
        assert found.verdict[path] == 'not identifiable', path
    # what balances is seen: neither shrinks towards a robot without mass
    ratio = found.values['link.link_1.first_moment.x'] / found.values['link.link_1.inertia.izz']
    wanted = 0.18 * 0.165 / (0.0016335 + 0.18 * 0.165**2)
    assert ratio == pytest.approx(wanted, rel=0.02)
    assert found.values['link.link_1.first_moment.x'] > 0.5 * 0.18 * 0.165
    assert any('link.link_1.first_moment.x' in line for line in found.combinations)


def test_a_swing_without_effort_tells_the_damping_of_a_known_body() -> None:
    pendulum = dn.load_robot(ROBOTS / 'rigid_pendulum.urdf', gravity=(0, -9.81, 0))
    wrong = pendulum.with_overrides({'joint.joint_1.damping': 0.01})
    found = dn.identify_model(wrong, swing(pendulum), ['joint.joint_1.damping'], held_out=0.0)
    assert found.verdict['joint.joint_1.damping'] == 'found'
    # positions with 1e-5 rad of noise, 200 a second: far below one per cent
    assert found.values['joint.joint_1.damping'] == pytest.approx(0.0308, rel=0.02)


def swing(pendulum: dn.Robot) -> dn.Recording:
    """A free swing in gravity from near the horizontal, its effort recorded as 0."""
    t = np.arange(0.0, 3.0, 0.005)
    run = dn.simulate(pendulum, np.array([-0.2]), np.zeros(1), t)
    noise = 1e-5 * np.random.default_rng(1).standard_normal(run.q.shape)
    return dn.Recording(t, ('joint_1',), run.q + noise, np.zeros_like(run.q), run.qd)


def test_currents_times_torque_constants_are_efforts(rig: dn.Robot, tmp_path: Path) -> None:
    values = swings()
    current = np.cos(3.0 * values['time'])
    file = table(tmp_path / 'run.csv', **values, amperes=current)
    named = {
        'joint_1.position': 'hub',
        'joint_2.position': 'joint_2',
        'joint_1.effort': 'amperes',
    }
    settings = RecordingSettings(columns=named, torque_constants={'joint_1': -1.9})
    found = read_source(file, rig, settings)
    np.testing.assert_allclose(found.effort[:, found.joints.index('joint_1')], -1.9 * current)
    for joint, constant, rule in (
        ('elbow', 1.0, r'must be of a recorded joint \(joint_1, joint_2\), got elbow'),
        ('joint_1', 0.0, r'must be finite and not 0 N m/A'),
    ):
        bad = replace(settings, torque_constants={joint: constant})
        with pytest.raises(dn.BagError, match=rule):
            read_source(file, rig, bad)


TURNING = """<robot name="boom"><link name="base"/>
<link name="boom"><inertial><origin xyz="0.5 0 0"/><mass value="1"/>
<inertia ixx="0.01" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial></link>
<joint name="swing" type="continuous"><parent link="base"/><child link="boom"/>
<axis xyz="0 0 1"/><limit effort="50" velocity="10"/></joint></robot>"""


@pytest.mark.parametrize('with_rates', [False, True])
def test_turns_of_a_continuous_joint_change_nothing(tmp_path: Path, with_rates: bool) -> None:
    robot, t = dn.load_robot(TURNING), 0.01 * np.arange(300)
    q = 2.4 + 1.8 * np.sin(t)
    columns = {'swing/position': q, 'swing/effort': -1.8 * np.sin(t)}
    columns |= {'swing/velocity': 1.8 * np.cos(t)} if with_rates else {}
    wrapped = columns | {'swing/position': (q + np.pi) % (2.0 * np.pi) - np.pi}
    assert np.abs(np.diff(wrapped['swing/position'])).max() > 6.0
    plain, turned = (
        read_source(table(tmp_path / name, time=t, **each), robot)
        for name, each in (('plain.csv', columns), ('wrapped.csv', wrapped))
    )
    np.testing.assert_allclose(turned.position, plain.position, atol=1e-9)
    assert turned.doubts == plain.doubts == ()


def test_jumps_that_are_no_turns_are_doubted(tmp_path: Path) -> None:
    robot, t = dn.load_robot(TURNING), 0.01 * np.arange(300)
    q = 0.3 * np.sin(t)
    q[100] += 0.8
    q[200:] += 0.5
    path = table(tmp_path / 'jumps.csv', time=t, **{'swing/position': q, 'swing/effort': q})
    recording = read_source(path, robot)
    wild, place = recording.doubts
    assert wild.startswith('swing: position must be without wild samples, got 2 jumps')
    assert place.startswith('swing: position must go on, got 1 jump, the first by 0.499')
    found = dn.identify_model(robot, recording, ['joint.swing.damping'])
    assert {f'jumps.csv: {doubt}' for doubt in recording.doubts} <= {*found.reasons}


@pytest.mark.parametrize('size', [1e-300, 1e-12])
def test_an_effort_that_is_rounding_counts_as_none(size: float) -> None:
    pendulum = dn.load_robot(ROBOTS / 'rigid_pendulum.urdf')
    run = recorded(pendulum, sweeping(1, 3), 2.0)
    free = ['link.*.inertial', 'joint.*.damping', 'effort.joint_1.gain', 'delay.effort']
    found = [
        dn.identify_model(pendulum, replace(run, effort=effort), free, held_out=0.0)
        for effort in (0.0 * run.effort, size * np.sin(50.0 * run.t)[:, None])
    ]
    assert found[1].verdict == found[0].verdict
    assert found[1].values == pytest.approx(found[0].values)


def test_an_effort_that_is_a_current_is_a_reason() -> None:
    pendulum = dn.load_robot(ROBOTS / 'rigid_pendulum.urdf')
    run = recorded(pendulum, sweeping(1, 3), 3.0)
    found = dn.identify_model(
        pendulum, replace(run, effort=run.effort / 12.0), ['joint.joint_1.damping']
    )
    assert any('effort must be the torque of the joint' in reason for reason in found.reasons)


def test_equations_without_a_solution_are_an_error_of_the_recordings(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def fails(*_: object, **__: object) -> None:
        raise np.linalg.LinAlgError('Eigenvalues did not converge')

    pendulum = dn.load_robot(ROBOTS / 'rigid_pendulum.urdf')
    run = recorded(pendulum, sweeping(1, 3), 1.0)
    monkeypatch.setattr(ModelSearch, 'fit', fails)
    with pytest.raises(dn.IdentificationError, match=r'truth: recordings must .* not converge'):
        dn.identify_model(pendulum, run, ['joint.joint_1.damping'])
