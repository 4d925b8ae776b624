"""`denoc identify RUN`: what a run tells of its robot, without further options."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from page_look import require_one_look

import denoc_ros as dn
from denoc_ros.bags.joint_state import JOINT_STATE, JointStateMessage
from denoc_ros.bags.reader import DESCRIPTION_ATTACHMENT, SESSION_ATTACHMENT, read_attachment
from denoc_ros.bags.series import read_joint_states
from denoc_ros.bags.writer import BagWriter
from denoc_ros.cli.main import main
from denoc_ros.errors import BagError, IdentificationError
from denoc_ros.identification.run_numbers import FreeDecay, combined_modes
from denoc_ros.identification.verbs.actions import default_action
from denoc_ros.model.overrides import edited_description

ROBOT = Path(__file__).resolve().parents[3] / 'config' / 'robots' / 'canadarm_gauges.urdf'
SCENARIO = """
gravity: [0, 0, 0]
torque:
  kind: rigid_inverse_dynamics
  reference: {kind: book, form: half, rate: [0.3, 0.2, 0.4], period: [3, 2, 2], duration: 3}
duration: 3
output_rate: 250
"""
TOPICS = ('/joint_states', '/strain')
TRUTH: dict[str, Any] = {
    'beam.link_1.y.ei': 1.1e5,
    'beam.link_2.y.ei': 1.7e5,
    'payload.tool.mass': 12.0,
    'payload.tool.com': [-1.0, 0.0, 0.0],
}
NEEDED = ('beam.link_1.y.ei', 'beam.link_2.y.ei', 'payload.tool.mass', 'payload.tool.com.x')
TURN_S = 5.0  # between the begins of two phases


def simulated(folder: Path, numbers: dict[str, Any]) -> Path:
    """Simulate the arm with other numbers; the bag holds the arm as the file has it."""
    folder.mkdir()
    (folder / 'true.urdf').write_text(edited_description(ROBOT, numbers))
    (folder / 'scenario.yaml').write_text(SCENARIO)
    run = folder / 'run.mcap'
    words = ['simulate', str(folder / 'true.urdf'), str(folder / 'scenario.yaml'), '-o', str(run)]
    assert main(words) == 0
    return run


@pytest.fixture(scope='module')
def runs(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Return bags of the arm with the true numbers, and of the arm as the file has it."""
    folder = tmp_path_factory.mktemp('runs')
    return simulated(folder / 'true', TRUTH), simulated(folder / 'file', {})


def session(folder: Path, runs: tuple[Path, Path]) -> Path:
    """Return a session's directory with both runs as phases: the arm is reset in between."""
    plants: list[dict[str, Any]] = [TRUTH, {}]
    noted = []
    with BagWriter(folder / 'bag') as bag:
        bag.attach(DESCRIPTION_ATTACHMENT, ROBOT.read_text())
        for topic in TOPICS:
            bag.add_topic(topic, JOINT_STATE)
        bag.add_topic('/up/phase', 'std_msgs/msg/String')
        for k, run in enumerate(runs):
            begin_ns = 10**18 + round(1e9 * TURN_S * k)
            end_ns = begin_ns + round(3.1e9)
            bag.write_message('/up/phase', begin_ns, data=f'phase {k}')
            joints, strain = (
                read_joint_states(run, each) for each in ('/joint_states', '/strain')
            )
            said = JointStateMessage(joints.names, ('position', 'velocity', 'effort'))
            gauges = JointStateMessage(strain.names, ('position',))
            for row, t in enumerate(joints.t.tolist()):
                stamp_ns = begin_ns + round(1e9 * t)
                said.position[:], said.velocity[:] = joints.position[row], joints.velocity[row]
                said.effort[:] = joints.effort[row]
                gauges.position[:] = strain.position[row]
                bag.write('/joint_states', stamp_ns, said.bytes(stamp_ns))
                bag.write('/strain', stamp_ns, gauges.bytes(stamp_ns))
            bag.write_message('/up/phase', end_ns, data='')
            noted.append({'name': f'phase {k}', 'begin_ns': begin_ns, 'end_ns': end_ns})
            noted[-1]['plant'] = plants[k]
    document = {'gravity': [0, 0, 0], 'tip': 'tool', 'phases': noted}
    (folder / 'session.json').write_text(json.dumps(document))
    return folder


def true_number(path: str) -> float:
    """Return the true number at a path of one number."""
    if path.endswith('.com.x'):
        return float(TRUTH['payload.tool.com'][0])
    return float(TRUTH[path])


def test_a_run_gives_stiffness_and_payload_and_the_robot_with_them(
    runs: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    new = tmp_path / 'better.urdf'
    words = ['identify', str(runs[0]), '--robot', str(ROBOT), '--apply', str(new), '--json']
    assert main([*words, '-o', str(tmp_path / 'result')]) == 0
    (plant,) = json.loads(capsys.readouterr().out)['plants']
    found = {one['path']: one for one in plant['numbers']}
    for path in NEEDED:
        assert found[path]['verdict'] == 'found', path
        assert found[path]['needed']
        assert found[path]['value'] == pytest.approx(true_number(path), rel=0.01)
    # the load of a planar arm may lie anywhere across the plane
    assert not found['payload.tool.com.z']['needed']
    better = dn.load_robot(new, gravity=(0, 0, 0))
    assert better.tree.payloads['tool'].mass == pytest.approx(12.0, rel=0.01)
    require_one_look((tmp_path / 'result' / 'report.html').read_text())


def test_phases_with_another_plant_are_not_mixed(
    runs: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = session(tmp_path, runs)
    found = dn.identify(run)
    assert [each.phases for each in found.plants] == [('phase 0',), ('phase 1',)]
    for each, ei in zip(found.plants, (1.1e5, 1.0e5), strict=True):
        assert each.model.values['beam.link_1.y.ei'] == pytest.approx(ei, rel=0.01)
    with pytest.raises(IdentificationError, match=r'one robot, got 2 .*choose with --phase'):
        _ = found.overrides
    assert main(['identify', str(run), '--apply', str(tmp_path / 'new.urdf')]) == 1
    assert '--phase' in capsys.readouterr().err
    one = dn.identify(run, phases=['phase 0'])
    better = dn.load_robot(ROBOT, gravity=(0, 0, 0)).apply(one)
    assert better.tree.payloads['tool'].mass == pytest.approx(12.0, rel=0.01)


def test_a_payload_that_is_not_there_is_found_to_be_none(
    runs: tuple[Path, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(['identify', str(runs[1]), '--json']) == 0
    (plant,) = json.loads(capsys.readouterr().out)['plants']
    mass = next(one for one in plant['numbers'] if one['path'] == 'payload.tool.mass')
    assert mass['verdict'] == 'found'
    assert mass['interval'][1] < 1.0


def test_a_table_of_joints_and_gauges_is_a_run(runs: tuple[Path, Path], tmp_path: Path) -> None:
    joints, strain = (read_joint_states(runs[0], each) for each in TOPICS)
    names = [f'{joint}/{what}' for what in ('position', 'effort') for joint in joints.names]
    columns = [joints.t[:, None], joints.position, joints.effort, strain.position]
    table = tmp_path / 'run.csv'
    header = ','.join(['time', *names, *strain.names])
    np.savetxt(table, np.hstack(columns), delimiter=',', header=header, comments='')
    words = ['identify', 'run', str(table), '--robot', str(ROBOT), '--gravity', '0', '0', '0']
    assert main([*words, '--free', 'beam.*.ei', 'payload.tool']) == 0


def test_a_bag_with_topics_and_joints_of_other_names_is_a_run(
    runs: tuple[Path, Path], tmp_path: Path
) -> None:
    joints, strain = (read_joint_states(runs[0], each) for each in TOPICS)
    bag_path = tmp_path / 'foreign.mcap'
    with BagWriter(bag_path) as bag:
        for topic in ('/arm/states', '/strain'):
            bag.add_topic(topic, JOINT_STATE)
        names = [f'left_{name}' for name in joints.names]
        said = JointStateMessage(names, ('position', 'velocity', 'effort'))
        gauges = JointStateMessage(strain.names, ('position',))
        for row, stamp_ns in enumerate(joints.stamp_ns.tolist()):
            said.position[:], said.velocity[:] = joints.position[row], joints.velocity[row]
            said.effort[:] = joints.effort[row]
            gauges.position[:] = strain.position[row]
            bag.write('/arm/states', stamp_ns, said.bytes(stamp_ns))
            bag.write('/strain', stamp_ns, gauges.bytes(stamp_ns))
    words = ['identify', 'run', str(bag_path), '--robot', str(ROBOT), '--gravity', '0', '0', '0']
    assert main([*words, '--topic', '/arm/states', '--rename', 'left_=']) == 0


def test_a_replay_with_the_numbers_that_were_found_explains_the_run(
    runs: tuple[Path, Path],
) -> None:
    found = dn.identify(runs[0], ROBOT)
    start = dn.load_robot(ROBOT, gravity=(0, 0, 0))
    left, before = (dn.replay(runs[0], each) for each in (start.apply(found), start))
    true = '/plant/true_deflection'
    peak = left.deflection[true].measured_peak
    bent = peak > 0.0
    assert (left.deflection[true].rms < 1e-3 * peak)[bent].all()
    assert (before.deflection[true].rms > 20.0 * left.deflection[true].rms)[bent].all()


def test_a_run_without_robot_says_what_is_missing(runs: tuple[Path, Path], tmp_path: Path) -> None:
    bare = tmp_path / 'bare.mcap'
    with BagWriter(bare) as bag:
        bag.add_topic('/joint_states', JOINT_STATE)
        said = JointStateMessage(('joint_1',), ('position',))
        bag.write('/joint_states', 10**18, said.bytes(10**18))
    with pytest.raises(BagError, match='bag must hold the robot'):
        dn.identify(bare)


def test_options_of_a_signal_make_the_command_one_of_a_signal(
    runs: tuple[Path, Path], tmp_path: Path
) -> None:
    bag = str(runs[0])
    assert read_attachment(runs[0], SESSION_ATTACHMENT)
    assert default_action([bag]) == 'run'
    assert default_action([bag, '--phase', 'a']) == 'run'
    assert default_action([str(tmp_path / 'nothing'), '--apply', 'new.urdf']) == 'run'
    assert default_action([bag, '--topic', '/strain', '--field', 'link_1_y_root']) == 'modal'
    assert default_action([bag, bag]) == 'modal'
    assert default_action([str(tmp_path / 'nothing')]) == 'modal'


def decay(link: str, frequency: float, ratio: float, half: float) -> FreeDecay:
    """Return a good decay whose damping ratio has an interval of twice a half."""
    ends = ratio - half, ratio + half
    return FreeDecay('run', 0.0, 'gauge', link, frequency, ratio, ends, 'good', '')


def test_decays_of_one_mode_are_combined_by_their_intervals() -> None:
    narrow, wide = decay('arm', 2.00, 0.010, 1e-4), decay('arm', 2.02, 0.011, 1e-3)
    other = decay('arm', 5.0, 0.02, 1e-3)
    found = combined_modes([wide, other, narrow])
    assert [(each.link, each.decays) for each in found] == [('arm', 2), ('arm', 1)]
    assert found[0].damping_ratio == pytest.approx(0.010, rel=2e-3)
    assert found[1].interval == pytest.approx((0.019, 0.021))
    alike = combined_modes([decay('arm', 2.0, 0.01, 1e-3)] * 4)
    assert alike[0].interval == pytest.approx((0.0095, 0.0105))
    assert combined_modes([decay('arm', 2.0, 0.01, 1e-3), decay('boom', 2.0, 0.01, 1e-3)])[1:]
