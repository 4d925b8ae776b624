"""Films and strips: as many frames as they should have, and a robot that moves in them."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import imageio_ffmpeg
import numpy as np
import pytest
from node_robots import two_links
from numpy.typing import NDArray
from PIL import Image
from simulated_bags import SimulatedBag

from denoc_ros.bags.writer import BagWriter
from denoc_ros.dynamics.robot import load_robot
from denoc_ros.errors import ConfigError, StateError
from denoc_ros.simulation.recorded.run_snapshots import RecordedRun
from denoc_ros.units import round_up
from denoc_ros.viewer.film import Look, frame_times, write_film, write_strip
from denoc_ros.viewer.picture import Canvas, draw_header
from denoc_ros.viewer.scene_setup import SHOWN, SceneSetup, best_view

SMALL = Look(size=(320, 240), scale=5.0)
MOVED = 40  # of 255: more than what compression changes


@pytest.fixture(scope='module')
def recorded_motion(simulated_bag: SimulatedBag) -> RecordedRun:
    return RecordedRun(simulated_bag.path, simulated_bag.robot)


def share_that_differs(first: NDArray[np.uint8], last: NDArray[np.uint8]) -> float:
    gap = np.abs(first.astype(int) - last.astype(int)).max(axis=-1)
    return float(np.mean(gap > MOVED))


def test_gif_has_a_frame_per_time_and_moves(
    recorded_motion: RecordedRun, simulated_bag: SimulatedBag, tmp_path: Path
) -> None:
    path = tmp_path / 'run.gif'
    frames = write_film(recorded_motion, simulated_bag.robot, path, SMALL, fps=12.0)
    duration = recorded_motion.t[-1] - recorded_motion.t[0]
    assert frames == round(12.0 * duration)
    with Image.open(path) as film:
        assert film.size == SMALL.size
        assert film.n_frames == frames
        shown = 0
        first = np.asarray(film.convert('RGB'))
        for k in range(frames):
            film.seek(k)
            shown += film.info['duration']
        # a GIF counts in hundredths of a second
        assert shown == pytest.approx(1e3 * frames / 12.0, abs=10.0)
        assert share_that_differs(first, np.asarray(film.convert('RGB'))) > 0.005
        # the paper is white, and stays so
        assert np.mean((first == 255).all(axis=-1)) > 0.3


def test_mp4_has_a_frame_per_time_and_moves(
    recorded_motion: RecordedRun, simulated_bag: SimulatedBag, tmp_path: Path
) -> None:
    path = tmp_path / 'run.mp4'
    done: list[float] = []
    frames = write_film(recorded_motion, simulated_bag.robot, path, SMALL, 20.0, 2.0, done.append)
    duration = recorded_motion.t[-1] - recorded_motion.t[0]
    assert frames == round(20.0 * duration / 2.0) == len(done)
    assert done[-1] == pytest.approx((frames - 1) * 2.0 / 20.0)
    reader = imageio_ffmpeg.read_frames(str(path))
    about = next(reader)
    assert about['size'] == SMALL.size
    assert about['fps'] == 20.0
    pictures = [np.frombuffer(raw, np.uint8).reshape(240, 320, 3) for raw in reader]
    assert len(pictures) == frames
    assert share_that_differs(pictures[0], pictures[-1]) > 0.005


@pytest.mark.long
def test_phases_beside_each_other_are_in_step(tmp_path: Path) -> None:
    """Phases of 2 and 3 s that begin alike: halves are equal at first, later they are not."""
    robot, path = load_robot(two_links()), tmp_path / 'phases.mcap'
    with BagWriter(path) as bag:
        bag.add_topic('/joint_states', 'sensor_msgs/msg/JointState')
        bag.add_topic('/up/phase', 'std_msgs/msg/String')
        marks = {0: 'slow', 20: '', 30: 'fast', 60: ''}
        for k in range(61):
            stamp = 10**18 + k * 10**8
            angle = 0.02 * k if k < 30 else 0.04 * (k - 30)
            names = list(robot.joint_names)
            bag.write_message('/joint_states', stamp, name=names, position=[angle, 0.0])
            if k in marks:
                bag.write_message('/up/phase', stamp, data=marks[k])
    run = RecordedRun(path, robot)
    film_path = tmp_path / 'two.gif'
    look = Look(size=(640, 320), scale=1.0, phases=('slow', 'fast'))
    assert write_film(run, robot, film_path, look, fps=10.0) == 30
    with Image.open(film_path) as film:
        halves = []
        for k in (0, 15, 22, 29):
            film.seek(k)
            pixels = np.asarray(film.convert('RGB'))
            halves.append((pixels[60:290, 34:320], pixels[60:290, 346:632]))
    assert share_that_differs(halves[0][0], halves[1][0]) > 0.005
    # the first phase is over after 2 s and stays, the second one goes on
    assert share_that_differs(halves[2][0], halves[3][0]) < 1e-3
    assert share_that_differs(halves[2][1], halves[3][1]) > 0.005
    with pytest.raises(ConfigError, match=r"each must be one of 'slow', 'fast', got 'none'"):
        write_film(run, robot, film_path, Look(phases=('slow', 'none')))


def test_strip_shows_moments_that_differ(
    recorded_motion: RecordedRun, simulated_bag: SimulatedBag, tmp_path: Path
) -> None:
    path = tmp_path / 'run.png'
    write_strip(recorded_motion, simulated_bag.robot, path, Look(size=(640, 480)), count=2)
    with Image.open(path) as image:
        assert image.width == 640
        assert image.height <= 480
        pixels = np.asarray(image.convert('RGB'))
    one = pixels.copy()
    write_strip(recorded_motion, simulated_bag.robot, path, Look(size=(640, 480), scale=1.0), 2)
    with Image.open(path) as image:
        other = np.asarray(image.convert('RGB'))
    assert len(np.unique(pixels.reshape(-1, 3), axis=0)) > 50
    # another exaggeration is another picture
    assert one.shape != other.shape or share_that_differs(one, other) > 0.001


@pytest.mark.parametrize('factor', [2.0, 10.0, 100.0])
def test_scale_moves_the_tip_by_its_factor(repository: Path, factor: float) -> None:
    robot = load_robot(repository / 'config/robots/one_flexible_link.urdf', gravity=(0, 0, 0))
    q = np.zeros(robot.n)
    q[robot.flexible_indices[0]] = 1e-6
    staging = SceneSetup(robot, q[np.newaxis], factor)
    straight, once, drawn = (
        staging.camera.project(staging.vertices(q, scale)) for scale in (0.0, 1.0, None)
    )
    tip = int(np.argmax(np.linalg.norm(once - straight, axis=1)))
    moved = np.linalg.norm((drawn - straight)[tip, :2]) / np.linalg.norm(
        (once - straight)[tip, :2]
    )
    # foreshortening and the section's turn are of second order: 1e-6 m times 100
    assert moved == pytest.approx(factor, rel=1e-3)
    assert staging.ghost(q).reshape(-1, 2).max(axis=0) == pytest.approx(
        straight[:, :2].max(axis=0), abs=1e-12
    )


def test_chosen_scale_shows_the_deflection_and_does_not_overdo_it(
    simulated_bag: SimulatedBag,
) -> None:
    robot, states = simulated_bag.robot, simulated_bag.run.q[::50]

    def drawn(scale: float) -> float:
        gaps = [staging.vertices(q, scale) - staging.vertices(q, 0.0) for q in states]
        return max(float(np.linalg.norm(gap, axis=1).max()) for gap in gaps)

    staging = SceneSetup(robot, states)
    size = float(np.linalg.norm(staging.high - staging.low))
    assert drawn(staging.scale) < 2.0 * SHOWN * size
    assert staging.scale == 100.0 or drawn(2.5 * staging.scale) > SHOWN * size / 2.0
    straight = np.zeros_like(states)
    assert SceneSetup(robot, straight).scale == 1.0


def test_strain_is_that_of_the_curvature(repository: Path) -> None:
    """The colour bar ends at half the thickness times the largest curvature of what is shown."""
    robot = load_robot(repository / 'config/robots/one_flexible_link.urdf', gravity=(0, 0, 0))
    q = np.zeros(robot.n)
    q[robot.flexible_indices[0]] = 0.01
    staging = SceneSetup(robot, q[np.newaxis], 20.0)
    twice = SceneSetup(robot, 2.0 * q[np.newaxis], 1.0)
    assert staging.strain > 0.0
    # the strain is the true one, however much larger the deflection is drawn
    assert twice.strain == pytest.approx(2.0 * staging.strain, rel=1e-12)
    colours = staging.robot(q).colours
    assert np.ptp(colours[:, 0] - colours[:, 2]) > 0.5
    assert np.ptp(np.diff(staging.robot(np.zeros(robot.n)).colours, axis=1)) < 0.3


def test_a_robot_that_flew_away_is_refused(simulated_bag: SimulatedBag) -> None:
    states = np.full((2, simulated_bag.robot.n), 1e9)
    with pytest.raises(StateError, match=r'must be within 1e\+06 m of the base, got'):
        SceneSetup(simulated_bag.robot, states)


def area(corners: NDArray[np.float64]) -> float:
    one, other = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return float(np.abs(one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0]).sum())


@pytest.mark.parametrize('name', ['one_flexible_link', 'ssrms', 'five_bar_ffff'])
def test_of_closed_surfaces_the_near_side_is_drawn(repository: Path, name: str) -> None:
    """Near and far side of a closed surface have the same area in the picture."""
    robot = load_robot(repository / f'config/robots/{name}.urdf', gravity=(0, 0, 0))
    q = np.zeros(robot.n)
    staging = SceneSetup(robot, q[np.newaxis], 1.0, 'iso')
    assert area(staging.robot(q).corners) == pytest.approx(0.5 * area(staging.ghost(q)), rel=1e-9)


def test_what_is_nearer_is_drawn_later() -> None:
    boxes = ''.join(
        f'<visual><origin xyz="0 0 {z}"/><geometry><box size="1 1 0.1"/></geometry>'
        f'<material name="{name}"><color rgba="{colour} 1"/></material></visual>'
        for name, z, colour in (('above', 1, '1 0 0'), ('below', 0, '0 0 1'))
    )
    robot = load_robot(f'<robot name="plates"><link name="base">{boxes}</link></robot>')
    drawn = SceneSetup(robot, np.zeros((1, 0)), 1.0, 'top').robot(np.zeros(0)).colours
    assert drawn[0, 2] > drawn[0, 0]
    assert drawn[-1, 0] > drawn[-1, 2]


def test_the_side_that_is_seen_has_its_own_strain() -> None:
    """A beam that bends up is pressed on top and stretched below."""
    robot = load_robot(two_links().replace('direction="y"', 'direction="z"'))
    q = np.zeros(robot.n)
    q[robot.coordinate_names.index('one/z1')] = 0.01
    drawn = SceneSetup(robot, q[np.newaxis], 1.0, 'top').robot(q)
    redder = drawn.colours[:, 0] - drawn.colours[:, 2]
    # its flanks are seen from the edge
    assert area(drawn.corners[redder > 0.3]) < 0.05 * area(drawn.corners[redder < -0.3])


def test_view_is_onto_the_plane_of_the_motion() -> None:
    body, motion = np.random.default_rng(1).uniform(-1.0, 1.0, (2, 50, 3))
    still = np.zeros((4, 1, 1))
    moving = np.linspace(0.0, 1.0, 4)[:, np.newaxis, np.newaxis]
    assert best_view(body + still * motion) == 'iso'
    assert best_view(body + moving * motion) == 'iso'
    for axis, view in enumerate(('front', 'side', 'top')):
        flat = np.where(np.arange(3) == axis, 0.05, 1.0)
        # however little it moves, and where it does not move, what it is itself
        assert best_view(body + 1e-3 * moving * flat * motion) == view
        assert best_view(flat * body + still * motion) == view


def test_frame_times_fill_the_run() -> None:
    times = frame_times(2.0, 5.0, 10.0, 0.5)
    assert len(times) == 60
    assert times[0] == 2.0
    np.testing.assert_allclose(np.diff(times), 0.05)
    assert times[-1] == pytest.approx(4.95)
    with pytest.raises(
        ConfigError, match=r'fps must be > 0, got -1.*\n.*speed must be > 0, got 0'
    ):
        frame_times(0.0, 1.0, -1.0, 0.0)


def test_grid_steps_are_round() -> None:
    assert [round_up(size) for size in (0.7, 1.0, 1.1, 3.0, 6.0, 0.013)] == pytest.approx(
        [1.0, 1.0, 2.0, 5.0, 10.0, 0.02]
    )


def test_bad_pictures_are_refused_with_every_finding(
    recorded_motion: RecordedRun, simulated_bag: SimulatedBag, tmp_path: Path
) -> None:
    with pytest.raises(ConfigError) as refused:
        Look(scale=-1.0, view='below', size=(33, 20_000))
    assert len(refused.value.findings) == 3
    with pytest.raises(ConfigError, match=r'must end in \.mp4 or \.gif'):
        write_film(recorded_motion, simulated_bag.robot, tmp_path / 'run.avi')
    with pytest.raises(ConfigError, match=r'must end in \.png'):
        write_strip(recorded_motion, simulated_bag.robot, tmp_path / 'run.jpg')
    with pytest.raises(ConfigError, match='number of moments must be 1 to 24, got 0'):
        write_strip(recorded_motion, simulated_bag.robot, tmp_path / 'run.png', count=0)


@pytest.mark.parametrize('suffix', ['.gif', '.mp4'])
def test_an_unfinished_film_is_taken_away(
    recorded_motion: RecordedRun, simulated_bag: SimulatedBag, tmp_path: Path, suffix: str
) -> None:
    def interrupt(elapsed: float) -> None:
        if elapsed > 0.2:
            raise KeyboardInterrupt

    path = tmp_path / f'run{suffix}'
    with pytest.raises(KeyboardInterrupt):
        write_film(recorded_motion, simulated_bag.robot, path, SMALL, progress=interrupt)
    assert not path.exists()


def test_films_need_neither_viser_nor_a_display() -> None:
    check = (
        'import sys, denoc_ros.viewer.film as film; '
        'print(sorted({"viser", "tkinter", "matplotlib.pyplot"} & set(sys.modules)))'
    )
    found = subprocess.run(
        [sys.executable, '-c', check], capture_output=True, text=True, check=True
    )
    assert found.stdout.strip() == '[]'


@pytest.mark.parametrize('width', [320, 700, 1280])
@pytest.mark.parametrize('words', [1, 4])
def test_texts_of_a_header_do_not_overlap(width: int, words: int) -> None:
    canvas = Canvas((width, 320))
    title, caption = ('canadarm: tip ' * words, 'deflection × 1, blue: path of the tip ' * words)
    time = draw_header(canvas.figure, 0.95, title, caption, 't = 999.99 s')
    boxes = [text.get_window_extent() for text in canvas.figure.texts]
    assert time.get_text() == 't = 999.99 s'
    assert boxes[0].x0 > 0.0
    assert boxes[0].x1 < boxes[1].x0
    assert boxes[1].x1 < boxes[2].x0
    assert boxes[2].x1 < width
