"""`denoc view RUN`: the page of a run, its film and its strip, from the command line."""

from __future__ import annotations

import base64
import io
import json
import re
import sys
import threading
from pathlib import Path

import pytest
from PIL import Image
from simulated_bags import SimulatedBag

from denoc_ros.bags.writer import BagWriter
from denoc_ros.cli.main import build_parser, main
from denoc_ros.viewer import view_verb as view
from denoc_ros.viewer.view_verb import open_run

GRAVITY = ['--gravity', '0', '-9.81', '0']


@pytest.mark.long
def test_film_and_strip_come_out_of_one_command(
    simulated_bag: SimulatedBag, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    film, strip = tmp_path / 'run.gif', tmp_path / 'run.png'
    command = ['view', str(simulated_bag.path), *GRAVITY, '--size', '320x240', '--from', '0.5']
    command += ['--to', '1.5', '--speed', '0.5', '--fps', '10', '--video', str(film)]
    assert main([*command, '--strip', str(strip), '--moments', '3', '--view', 'iso']) == 0
    assert capsys.readouterr().out.split() == [str(strip), str(film)]
    with Image.open(film) as image:
        # a second at half its speed, less the part of a frame at its end
        assert image.n_frames == pytest.approx(20, abs=1)
    with Image.open(strip) as image:
        assert image.width == 320


def test_page_of_a_run_opens(
    simulated_bag: SimulatedBag,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    ended = threading.Event()
    ended.set()
    monkeypatch.setattr(view, '_ending', lambda: ended)
    assert main(['view', str(simulated_bag.path), '--port', '0', '--no-browser']) == 0
    assert re.search(r'open http://127\.0\.0\.1:\d+ ', capsys.readouterr().out)


def test_a_run_s_directory_says_its_name_and_gravity(
    simulated_bag: SimulatedBag, tmp_path: Path
) -> None:
    run = tmp_path / 'run_0.55s'
    (run / 'bag').mkdir(parents=True)
    with BagWriter(run / 'bag' / 'whole') as bag:
        bag.add_topic('/joint_states', 'sensor_msgs/msg/JointState')
        names = list(simulated_bag.robot.joint_names)
        for k in range(5):
            bag.write_message(
                '/joint_states', 10**9 + k * 10**8, name=names, position=[0.1 * k, 0]
            )
    for file in (run / 'bag' / 'whole').iterdir():
        file.rename(run / 'bag' / file.name)
    (run / 'session.json').write_text(json.dumps({'name': 'demo', 'gravity': [0, -1, 0]}))
    robot = tmp_path / 'two.urdf'
    robot.write_text(simulated_bag.robot.tree.source)
    arguments = ['view', str(run), '--robot', str(robot)]
    opened = open_run(build_parser(arguments).parse_args(arguments), run, 60.0)
    assert opened.title.endswith(': demo')
    assert opened.folder == tmp_path
    assert list(opened.robot.gravity) == [0.0, -1.0, 0.0]
    assert opened.run.source == 'joints'
    (run / 'session.json').unlink()  # then the directory's name, with its dot
    opened = open_run(build_parser(arguments).parse_args(arguments), run, 60.0)
    assert opened.title.endswith(': run_0.55s')


@pytest.mark.parametrize(
    ('options', 'message'),
    [
        (['--video', 'run.avi'], r'run\.avi: the file must end in \.mp4 or \.gif'),
        (['--strip', 'run.jpg'], r'run\.jpg: the file must end in \.png'),
        (['--strip', 'run.png', '--size', '3'], r'--size: it must be WxH in pixels'),
        (['--strip', 'run.png', '--moments', '0'], r'number of moments must be 1 to 24'),
        (['--strip', 'run.png', '--from', '9'], r'run must have moments from 9 to inf s'),
        (['--strip', 'run.png', '--from', '2', '--to', '1'], r'--to: it must be beyond --from'),
        (['--strip', 'run.png', '--source', 'replay'], r'bag must have replay/modal_state'),
        (['--strip', 'run.png', '--scale', '0.5'], r'--scale must be >= 1, <= 100'),
        (['--video', 'run.gif', '--fps', '0'], r'fps must be > 0'),
        (['--video', 'none/run.gif', '--size', '160x160', '--to', '0.1'], r'No such file'),
    ],
)
def test_bad_requests_are_said_plainly(
    simulated_bag: SimulatedBag,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    options: list[str],
    message: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(['view', str(simulated_bag.path), *options]) == 1
    assert re.search(message, capsys.readouterr().err)
    assert not list(tmp_path.iterdir())


def test_a_film_needs_a_run_and_a_run_a_robot(
    repository: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    robot = repository / 'config/robots/two_link_ff.urdf'
    assert main(['view', str(robot), '--strip', 'x.png']) == 1
    assert 'a run must be given' in capsys.readouterr().err
    with BagWriter(tmp_path / 'bare.mcap') as bag:
        bag.add_topic('/joint_states', 'sensor_msgs/msg/JointState')
    assert main(['view', str(tmp_path / 'bare.mcap'), '--strip', str(tmp_path / 'x.png')]) == 1
    assert 'bag must hold the robot where --robot is not given' in capsys.readouterr().err


@pytest.mark.long
def test_the_report_of_a_run_shows_how_it_moved(
    simulated_bag: SimulatedBag, tmp_path: Path
) -> None:
    output = tmp_path / 'page.html'
    assert main(['report', str(simulated_bag.path), '-o', str(output)]) == 0
    pictures = re.findall(
        r'alt="two_link\w* at moment \d of 6[^>]*base64,([^"]+)"', output.read_text()
    )
    assert len(set(pictures)) == 6
    for picture in pictures:
        with Image.open(io.BytesIO(base64.b64decode(picture))) as image:
            assert image.width == 460
            assert len(image.convert('RGB').getcolors(1 << 24) or ()) > 50


def test_without_viser_it_is_said_how_to_get_it(
    repository: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, 'viser', None)
    monkeypatch.delitem(sys.modules, 'denoc_ros.viewer.page', raising=False)
    assert main(['view', str(repository / 'config/robots/two_link_ff.urdf')]) == 1
    assert 'pip install "denoc_ros[viewer]"' in capsys.readouterr().err


def test_a_phase_is_shown_alone(simulated_bag: SimulatedBag, tmp_path: Path) -> None:
    path = tmp_path / 'phases.mcap'
    with BagWriter(path) as bag:
        bag.add_topic('/joint_states', 'sensor_msgs/msg/JointState')
        bag.add_topic('/up/phase', 'std_msgs/msg/String')
        names = list(simulated_bag.robot.joint_names)
        marks = {20: 'one', 50: '', 60: 'two', 90: ''}
        for k in range(100):
            stamp = 10**18 + k * 10**8
            bag.write_message('/joint_states', stamp, name=names, position=[0.0, 0.1 * k])
            if k in marks:
                bag.write_message('/up/phase', stamp, data=marks[k])
    robot = tmp_path / 'two.urdf'
    robot.write_text(simulated_bag.robot.tree.source)
    arguments = ['view', str(path), '--robot', str(robot), '--phase', 'two']
    run = open_run(build_parser(arguments).parse_args(arguments), path, 60.0).run
    assert run.span == pytest.approx((6.0, 9.0), abs=1e-6)
