"""The page as a server: what goes over the wire, and the command that serves it."""

from __future__ import annotations

import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import numpy as np
import pytest
from child_processes import child
from viewer_client import MOVING, ViewerClient

import denoc_ros as dn
from denoc_ros.cli.main import main
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import ConfigError, StateError
from denoc_ros.simulation.recorded.snapshot import Snapshot
from denoc_ros.viewer.page import Page, recorded_page
from denoc_ros.viewer.view import BANDS
from denoc_ros.viewer.view_verb import book_systems

TIMEOUT = 90.0  # s for what takes a second on a machine that does nothing else


@pytest.fixture(scope='module')
def robot(repository: Path) -> Robot:
    return dn.load_robot(repository / 'config/robots/canadarm.urdf', gravity=(0, 0, 0))


@pytest.fixture
def page(robot: Robot) -> Iterator[Page]:
    with Page(robot) as page:
        yield page


@contextmanager
def looked_at(page: Page) -> Iterator[ViewerClient]:
    """Give the page a client that looks, with what was sent at first read."""
    with closing(ViewerClient(page.address)) as client:
        wait_for_clients(page, 1)
        assert 'MeshMessage' in kinds(client)
        yield client


def wait_for_clients(page: Page, count: int) -> None:
    until = time.monotonic() + TIMEOUT
    while page.clients != count:
        assert time.monotonic() < until
        time.sleep(0.01)


def kinds(client: ViewerClient) -> list[str]:
    """Return the types of the messages that come until it is quiet."""
    found: list[str] = []
    while messages := client.receive(0.5):
        found += [message['type'] for message in messages]
    return found


def moments(robot: Robot) -> list[Snapshot]:
    times = np.linspace(0.0, 2.0, 41)
    return [
        Snapshot(float(t), np.full(robot.n, 0.02 * t), channels={'x [m]/a': float(t)})
        for t in times
    ]


def test_nothing_is_drawn_while_nobody_looks(page: Page, robot: Robot) -> None:
    drawn: list[Snapshot] = []
    original = page._view.draw

    def draw(moment: Snapshot, look: object) -> object:
        drawn.append(moment)
        return original(moment, look)  # type: ignore[arg-type]

    page._view.draw = draw  # type: ignore[method-assign, assignment]
    page.show(Snapshot(0.0, np.zeros(robot.n)))
    assert not drawn
    with looked_at(page) as client:
        assert drawn  # what was shown before it came
        drawn.clear()
        page.show(Snapshot(1.0, np.full(robot.n, 0.01)))
        assert len(drawn) == 1
        assert 3 <= kinds(client).count(MOVING) <= 2 * BANDS + 10  # few: meshes share colours
        page.show(Snapshot(1.1, np.full(robot.n, 0.01)))
        assert kinds(client).count(MOVING) == 0  # where nothing moves nothing is sent
    wait_for_clients(page, 0)
    drawn.clear()
    page.show(Snapshot(2.0, np.zeros(robot.n)))
    assert not drawn


def test_scrubbing_draws_the_moment_of_the_slider(page: Page, robot: Robot) -> None:
    run = moments(robot)
    page.play(run)
    playback = page._panel
    assert playback is not None
    shown = []
    for t in (0.0, 1.0, 1.024, 2.0):
        playback._slider.value = t  # type: ignore[union-attr]
        shown.append(page._moment.t)
    np.testing.assert_allclose(shown, [0.0, 1.0, 1.0, 2.0])


def test_playing_goes_on_while_somebody_looks_and_pauses(page: Page, robot: Robot) -> None:
    page.play(moments(robot))
    playback = page._panel
    playback.toggle()  # type: ignore[union-attr]
    time.sleep(0.3)
    assert page._moment.t == 0.0  # nobody looks
    with closing(ViewerClient(page.address)):
        until = time.monotonic() + TIMEOUT
        while page._moment.t < 0.2:
            assert time.monotonic() < until
            time.sleep(0.02)
        playback.toggle()  # type: ignore[union-attr]
        time.sleep(0.2)
        stopped = page._moment.t
        time.sleep(0.3)
        assert page._moment.t == stopped


def test_a_mode_plays_instead_of_what_is_shown(page: Page, robot: Robot) -> None:
    player = page._player
    assert player is not None
    player.find()
    first = player._choice.options[1]
    with looked_at(page):
        player._choice.value = first
        assert player.playing
        until = time.monotonic() + TIMEOUT
        while page._view._limit == 0.0:  # the mode bends what is straight
            assert time.monotonic() < until
            time.sleep(0.02)
        page.show(Snapshot(5.0, np.zeros(robot.n)))  # kept, and drawn when the mode ends
        player._choice.value = player._choice.options[0]
        assert not player.playing
        assert page._moment.t == 5.0
        assert page._view._limit == 0.0


def test_sliders_of_a_mechanism_keep_its_loops_closed(repository: Path) -> None:
    system = book_systems()['five_bar_ffff']
    robot = dn.load_robot(system.file, gravity=system.gravity)
    with Page(robot) as page:
        page.pose(system.joints)
        sliders = page._panel
        assert sliders._held == ('joint_1', 'joint_3')  # type: ignore[union-attr]
        for angle in (100.0, 110.0):
            (index, (slider, _)), *_ = sliders._sliders.items()  # type: ignore[union-attr]
            slider.value = angle
            assert page._moment.q[index] == pytest.approx(np.radians(angle))
            assert np.abs(robot.closure(page._moment.q)).max() < 1e-8
            deflected = np.abs(page._moment.q[robot.flexible_indices]).max()
            assert deflected > 1e-6  # it sags


def test_moments_of_another_robot_are_refused(page: Page) -> None:
    with pytest.raises(StateError, match='q must'):
        page.show(Snapshot(0.0, np.zeros(3)))
    with pytest.raises(StateError, match='must be finite'):
        page.show(Snapshot(0.0, np.full(page._view.robot.n, np.nan)))
    with pytest.raises(StateError, match='must have moments'):
        page.play([])


def test_an_address_that_is_taken_or_none_is_refused(page: Page, robot: Robot) -> None:
    port = int(page.address.rpartition(':')[2])
    with pytest.raises(ConfigError, match=f'{port}: .*in use'):
        Page(robot, port=port)
    with pytest.raises(ConfigError, match='host and port must be ones to listen on'):
        Page(robot, host='not a host')
    with pytest.raises(ConfigError, match='port must be 0 to 65535'):
        Page(robot, port=70000)


def test_no_tunnel_to_a_public_server_is_ever_opened(page: Page) -> None:
    assert page.server.request_share_url() is None


def test_view_serves_until_interrupted(repository: Path, tmp_path: Path) -> None:
    command = [sys.executable, '-m', 'denoc_ros.cli.main', 'view']
    robot = str(repository / 'config' / 'robots' / 'four_bar_fff.urdf')
    options = ['--host', '0.0.0.0', '--port', '0', '--no-browser', '--gravity', '0', '-9.81', '0']
    with child(
        [*command, robot, *options],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        cwd=tmp_path,
        env={**os.environ, 'PYTHONPATH': str(repository)},
    ) as process:
        assert process.stdout is not None
        line = process.stdout.readline()
        assert line.startswith('open http://'), line
        port = int(line.split()[1].rpartition(':')[2])
        socket.create_connection(('127.0.0.1', port), timeout=TIMEOUT).close()
        process.send_signal(signal.SIGINT)
        rest, errors = process.communicate(timeout=TIMEOUT)
    assert process.returncode == 0
    assert rest == ''
    assert 'served beyond this machine (0.0.0.0)' in errors
    assert 'Traceback' not in errors


@pytest.mark.parametrize(
    ('arguments', 'message'),
    [
        (['gone.urdf'], 'gone.urdf'),
        (['--scale', '0'], '--scale must be >= 1, <= 100'),
        (['--host', 'not a host'], 'host and port must be'),
    ],
)
def test_view_says_what_is_wrong(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(['view', '--no-browser', *arguments]) == 1
    assert message in capsys.readouterr().err


def test_every_system_of_the_gallery_has_its_place(repository: Path) -> None:
    systems = book_systems()
    assert set(systems) == {f.stem for f in (repository / 'config' / 'robots').glob('*.urdf')}
    assert systems['rssr_rrf'].gravity == (0, -9.81, 0)
    assert systems['five_bar_ffff'].joints['joint_1'] == pytest.approx(np.radians(108.0))


def test_a_recorded_page_has_the_whole_run_and_needs_no_server(robot: Robot) -> None:
    run = [Snapshot(0.1 * k, np.full(robot.n, 0.02 * k)) for k in range(6)]
    page, first = recorded_page(robot, run), recorded_page(robot, run[:1])
    assert page.startswith('<!doctype html>')
    assert page._repr_html_() == page
    assert not re.search(r'src="(https?:)?//', page)
    assert len(page) > len(first) + 500  # frames that differ cost something


@pytest.mark.parametrize(
    ('moments', 'fps', 'error', 'words'),
    [
        (0, 20.0, StateError, 'must have moments, got none'),
        (1, 0.0, ConfigError, 'fps must be > 0 Hz, got 0'),
    ],
)
def test_a_recorded_page_refuses(
    robot: Robot, moments: int, fps: float, error: type[Exception], words: str
) -> None:
    with pytest.raises(error, match=words):
        recorded_page(robot, [Snapshot(0.0, np.zeros(robot.n))] * moments, fps=fps)
