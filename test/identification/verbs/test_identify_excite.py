"""`denoc identify excite`: a motion that sessions and scenarios read, its numbers and its page."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from page_look import require_one_look

from denoc_ros.cli.main import main
from denoc_ros.cli.motion_file import read_motion
from denoc_ros.cli.session.session_config import read_yaml
from denoc_ros.cli.verbs import INTERRUPTED
from denoc_ros.identification.model.excitation import SearchClock
from denoc_ros.simulation.reference_motion import trajectory_from_config

ROBOT = Path(__file__).resolve().parents[3] / 'config' / 'robots' / 'one_flexible_link.urdf'
WORDS = ['identify', 'excite', str(ROBOT), '--free', 'beam.*.ei', '--gravity', '0', '-9.81', '0']
QUICK = ['--duration', '3', '--harmonics', '3', '--time-limit', '1', '--noise', 'effort=0.02']
LIMITS = ['--position', 'joint_1=-0.5:0.5', '--velocity', 'joint_1=2', '--deflection']


@pytest.fixture(scope='module')
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp('excite')


@pytest.fixture(scope='module')
def said(folder: Path) -> str:
    """Return what the command prints, and leave its files in the folder."""
    from contextlib import redirect_stdout
    from io import StringIO

    files = ['-o', f'{folder}/motion.yaml', '--trajectory', f'{folder}/message.yaml']
    out = StringIO()
    with redirect_stdout(out):
        asked = [*files, '--page', f'{folder}/page.html', '--json', *LIMITS, 'link_1=0.01']
        assert main([*WORDS, *QUICK, *asked]) in (0, 2)
    return out.getvalue()


@pytest.mark.long
def test_a_scenario_drives_the_motion_within_its_limits(said: str, folder: Path) -> None:
    document = json.loads(said)
    motion = trajectory_from_config(read_yaml(folder / 'motion.yaml'), ['joint_1'])
    t, q, qd, qdd = motion.table(0.005)
    assert t[-1] == 3.0
    assert np.abs(q).max() <= 0.5
    assert np.abs(qd).max() <= 2.0
    for row in (0, -1):
        assert abs(qd[row, 0]) < 1e-9 * np.abs(qd).max()
        assert abs(qdd[row, 0]) < 1e-9 * np.abs(qdd).max()
    (folder / 'scenario.yaml').write_text(
        'gravity: [0, -9.81, 0]\nreference: motion.yaml\nduration: 3\noutput_rate: 100\n'
    )
    run = ['simulate', str(ROBOT), str(folder / 'scenario.yaml'), '-o', str(folder / 'run.mcap')]
    assert main(run) == 0
    named = {(one['what'], one['name']): one for one in document['limits']}
    assert named['deflection', 'link_1']['limit'] == 0.01
    assert all(one['value'] <= one['limit'] for one in document['limits'])


def test_the_message_is_the_same_motion(said: str, folder: Path) -> None:
    assert said
    motions = [
        read_motion(read_yaml(folder / name), folder / name, ['joint_1'])
        for name in ('motion.yaml', 'message.yaml')
    ]
    for one, other in zip(*motions, strict=True):
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-9)
    point = read_yaml(folder / 'message.yaml')['points'][-1]
    assert point['time_from_start'] == {'sec': 3, 'nanosec': 0}
    assert set(point) == {'positions', 'velocities', 'accelerations', 'time_from_start'}


def test_numbers_and_page_say_what_to_expect(said: str, folder: Path) -> None:
    document = json.loads(said)
    (one,) = document['parameters']
    assert one['path'] == 'beam.link_1.y.ei'
    assert one['interval'][0] < one['value'] < one['interval'][1]
    assert document['not_identifiable'] == document['not_by_any_motion'] == []
    assert document['combinations_seen'] == 1
    assert document['noise']['effort.joint_1'] == 0.02
    assert document['seconds'] > 0.0
    page = (folder / 'page.html').read_text()
    require_one_look(page)
    assert 'beam.link_1.y.ei' in page
    assert 'deflection link_1' in page


def test_an_existing_file_is_not_replaced(
    said: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert said
    before = (folder / 'motion.yaml').read_text()
    assert main([*WORDS, *QUICK, '-o', str(folder / 'motion.yaml')]) == 1
    assert 'output must not exist yet' in capsys.readouterr().err
    assert (folder / 'motion.yaml').read_text() == before


def test_what_nothing_shows_ends_with_three(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = [*WORDS, '--free', 'payload.link_1.com.z', *QUICK]
    assert main([*words, '-o', str(tmp_path / 'motion.yaml')]) == 3
    out = capsys.readouterr().out
    assert 'by no motion: nothing is seen of payload.link_1.com.z' in out
    assert 'expected verdict: not identifiable' in out
    assert '1 of 2 combinations are seen by any motion' in out


def test_an_interrupt_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(_clock: SearchClock) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(SearchClock, 'check', interrupted)
    assert main([*WORDS, *QUICK, '-o', str(tmp_path / 'motion.yaml')]) == INTERRUPTED
    assert 'interrupted' in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ('words', 'says'),
    [
        (['-o', 'motion.csv'], "--output must end in .yaml, got 'motion.csv'"),
        (['-o', 'm.yaml', '--interval', '0'], '--interval must be > 0 s, got 0.0'),
        (['-o', 'm.yaml', '--position', 'joint_1=1'], '--position must be JOINT=LOW:HIGH, got'),
        (['-o', 'm.yaml', '--noise', 'effort'], "--noise must be CHANNEL=VALUE, got 'effort'"),
        (['-o', 'm.yaml', '--velocity', 'joint_1=x'], '--velocity must be JOINT=VALUE, got'),
        (['-o', 'm.yaml', '--velocity', 'elbow=1'], "must be of joints of ['joint_1']"),
        (['-o', 'm.yaml', '--duration', '-1'], 'duration must be > 0 s, got -1.0'),
        (['-o', 'm.yaml', '--free', 'beam.none.ei'], "--free 'beam.none.ei' must be of one of"),
    ],
)
def test_bad_input_is_told(
    words: list[str], says: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    given = [
        str(tmp_path / word) if word.startswith(('m.', 'motion.')) else word for word in words
    ]
    assert main([*WORDS, *given]) == 1
    assert says in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
