"""`denoc view`: a page in the browser that shows a robot, a run, or the book's systems; films."""

from __future__ import annotations

import argparse
import dataclasses
import math
import os
import signal
import sys
import threading
import webbrowser
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from denoc_ros.cli.arguments import add_gravity, add_number, add_option, add_phase
from denoc_ros.cli.progress import Progress
from denoc_ros.cli.recorded_robot import robot_source
from denoc_ros.cli.session.session_config import find_file, read_yaml, share_directory
from denoc_ros.dynamics.robot import Robot, load_robot
from denoc_ros.errors import ConfigError, DenocError
from denoc_ros.simulation.recorded.run_files import (
    EARTH,
    find_bag,
    plant_of,
    read_session,
    recording_name,
)
from denoc_ros.terminal_text import say
from denoc_ros.viewer.scene_setup import AUTO, VIEWS

if TYPE_CHECKING:
    from denoc_ros.simulation.recorded.run_snapshots import RecordedRun
    from denoc_ros.viewer.film import Look
    from denoc_ros.viewer.page import Page

SOURCES = ('plant', 'predictor', 'replay', 'joints')
STRIP_RATE = 60.0  # Hz
DEFAULT_PORT = 8080
FIRST = 'canadarm'  # that the gallery shows
BAG_SUFFIXES = ('.mcap', '.db3')
PAGE_RATE = 60.0  # moments per second of a run, at most
DESCRIPTION = (
    'Serve a page that shows the deformed robot until interrupted, on this machine only unless '
    '--host allows more. Without a robot: a gallery of the systems in the book. With --video or '
    '--strip: write a film or a picture of a run instead.'
)


@dataclass(frozen=True)
class OpenedRun:
    """A run and its robot."""

    run: RecordedRun
    robot: Robot
    title: str  # the robot's name and the run's
    # where relative names of the robot's mesh files start, where it came from a file
    folder: Path | None


def add_run_options(parser: argparse.ArgumentParser) -> None:
    """Declare the options that select a part of a run, and its robot."""
    group = parser.add_argument_group('a recorded run')
    add_option(
        group,
        '--robot ROBOT',
        'URDF file of the robot, in this folder or in the installed package; default: '
        'the one in the bag',
    )
    add_option(
        group,
        '--source',
        'source of the deflection; default: the first of these in the bag',
        '',
        choices=SOURCES,
    )
    add_phase(group)
    add_option(group, '--from S', 'first time to show [s]', -math.inf, dest='start')
    add_option(group, '--to S', 'last time to show [s]', math.inf, dest='end')


def open_run(args: argparse.Namespace, path: Path, rate: float) -> OpenedRun:
    """Open a run.

    Raises
    ------
    BagError, ConfigError, ModelError
        The run cannot be read, or not with this robot.
    """
    from denoc_ros.simulation.recorded.run_snapshots import RecordedRun

    if not args.start < args.end:
        raise ConfigError(
            '--to', [f'it must be beyond --from, got {args.start:g} to {args.end:g}']
        )
    bag, session = find_bag(path), read_session(path)
    source = robot_source(bag, args.robot)
    robot = load_robot(source, gravity=args.gravity or session.get('gravity', EARTH))
    if args.source in ('', 'plant'):
        robot = plant_of(robot, session)
    start, end = args.start, args.end
    if args.phase:
        whole = RecordedRun(bag, robot, args.source)
        spans = [whole.phase_span(name) for name in args.phase]
        start, end = max(start, min(spans)[0]), min(end, max(b for _, b in spans))
    run = RecordedRun(bag, robot, args.source, start, end, rate)
    file = source if isinstance(source, Path) else Path(str(session.get('robot', '')))
    name = session.get('name') or recording_name(path)
    title = robot.tree.name if name == robot.tree.name else f'{robot.tree.name}: {name}'
    return OpenedRun(run, robot, title, file.parent if file.is_file() else None)


def add_film_options(parser: argparse.ArgumentParser) -> None:
    """Declare the options of films and strips."""
    group = parser.add_argument_group('films and pictures of a recorded run, without a display')
    add_option(group, '--video FILE', 'write a film, .mp4 or .gif', type=Path)
    add_option(group, '--strip FILE', 'write some snapshots of the run into one .png', type=Path)
    add_option(
        group,
        '--phases NAME',
        'phases that the film shows beside each other, each from its beginning',
        [],
        nargs='+',
    )
    add_option(group, '--moments N', 'number of snapshots of the strip, default 6', 6)
    add_option(group, '--speed', 'speed of the film: 0.1 is ten times slower than real time', 1.0)
    add_option(group, '--fps', 'frames per second, default 30, for a GIF 20', type=float)
    add_option(group, '--size WxH', 'size in pixels, default 1280x720', '')
    add_option(group, '--view', 'direction of view', AUTO, choices=(AUTO, *VIEWS))


def write_pictures(args: argparse.Namespace, path: Path) -> list[Path]:
    """Write the film and the strip that were asked for.

    Raises
    ------
    DenocError
        For a file of another kind, an option that is out of range, or a run without moments.
    """
    from denoc_ros.viewer import film

    rate = STRIP_RATE
    if args.strip is not None:
        film.require_suffix(args.strip, film.STRIP_SUFFIXES)
    if args.video is not None:
        suffix = film.require_suffix(args.video, film.FILM_SUFFIXES)
        fps = film.FPS[suffix] if args.fps is None else args.fps
        film.frame_times(0.0, 1.0, fps, args.speed)
        rate = max(rate, fps / args.speed)
    look = film.Look(args.scale or 0.0, args.view, _size(args.size), phases=tuple(args.phases))
    opened = open_run(args, path, rate)
    look = dataclasses.replace(look, title=opened.title, folder=opened.folder)
    if args.strip is not None:
        film.write_strip(opened.run, opened.robot, args.strip, look, args.moments)
    if args.video is not None:
        _film(args, opened, look)
    return [file for file in (args.strip, args.video) if file is not None]


def _film(args: argparse.Namespace, opened: OpenedRun, look: Look) -> None:
    from denoc_ros.viewer.film import write_film

    run = opened.run
    start, end = run.span
    if look.phases:
        start, end = 0.0, max(b - a for a, b in map(run.phase_span, look.phases))
    with Progress().phase(f'drawing {args.video.name}', end - start) as show:
        write_film(run, opened.robot, args.video, look, args.fps, args.speed, show)


def _size(text: str) -> tuple[int, int]:
    if not text:
        return 1280, 720
    width, _, height = text.lower().partition('x')
    try:
        return int(width), int(height)
    except ValueError:
        raise ConfigError('--size', [f'it must be WxH in pixels, got {text!r}']) from None


def add_options(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    add_option(
        parser,
        'shown ROBOT|RUN',
        "a URDF file, a bag, or a run's directory; default: the gallery",
        nargs='?',
    )
    add_gravity(parser, None, "the run's, else 0 0 -9.81")
    text = (
        'factor that enlarges deflections; default: 1, for films chosen so that they are visible'
    )
    add_number(parser, '--scale X', float, text, '', 1.0, 100.0)
    add_option(parser, '--host', 'interface to listen on', '127.0.0.1')
    add_option(
        parser,
        '--port',
        'port of the page, 0 for a free one; default %(default)s',
        DEFAULT_PORT,
        type=int,
    )
    add_option(parser, '--no-browser', 'do not open a browser')
    add_run_options(parser)
    add_film_options(parser)


def run(args: argparse.Namespace) -> int:
    """Run the verb and return the exit status; errors are raised."""
    run_path = None if args.shown is None else Path(args.shown)
    if run_path is not None and not (run_path.is_dir() or run_path.suffix in BAG_SUFFIXES):
        run_path = None  # a robot
    if args.video is not None or args.strip is not None:
        if run_path is None:
            raise ConfigError(
                '--video, --strip',
                [f'a run must be given, a bag or a directory, got {args.shown}'],
            )
        for file in write_pictures(args, run_path):
            say(file)
        return 0
    return _serve_until_interrupted(args, run_path)


def _serve_until_interrupted(args: argparse.Namespace, run_path: Path | None) -> int:
    from denoc_ros.viewer import NO_VISER

    try:
        from denoc_ros.viewer.page import LOOPBACK
    except ImportError as error:
        raise DenocError(NO_VISER.format(error)) from error
    with _page(args, run_path) as page:
        if args.host not in LOOPBACK:
            say(
                f'denoc view: warning: the page is served beyond this machine ({args.host}): '
                'everybody who reaches it can watch and move the controls',
                file=sys.stderr,
            )
        ending = _ending()
        say(f'open {page.address} (end with Ctrl-C)', flush=True)
        if not args.no_browser:
            _open_browser(page.address)
        ending.wait()
    return 0


def _page(args: argparse.Namespace, run_path: Path | None) -> Page:
    if run_path is not None:
        opened = open_run(args, run_path, PAGE_RATE)
        page = _serve(args, opened.robot, title=opened.title, folder=opened.folder)
        page.play(opened.run)
        return page
    if args.shown is None:
        return _gallery(args)
    file = find_file(Path(args.shown), Path()) or Path(args.shown)
    robot = load_robot(file, gravity=args.gravity or EARTH)
    page = _serve(args, robot, folder=file.parent)
    page.pose()
    return page


def _gallery(args: argparse.Namespace) -> Page:
    from denoc_ros.viewer.page import Exhibit, offer

    systems = book_systems()

    def load(name: str) -> Exhibit:
        system = systems[name]
        robot = load_robot(system.file, gravity=args.gravity or system.gravity)
        joints = {joint: system.joints.get(joint, 0.0) for joint in robot.joint_names}
        return Exhibit(robot, joints)

    page = _serve(args, load(FIRST).robot, title='denoc_ros: systems of the book')
    offer(page, list(systems), FIRST, load)
    return page


def _serve(args: argparse.Namespace, robot: Robot, **options: Any) -> Page:
    from denoc_ros.viewer.page import Page

    return Page(robot, args.host, args.port, scale=args.scale or 1.0, **options)


class System(NamedTuple):
    """A robot of the package, with the gravity and posture of its scenario."""

    file: Path
    gravity: tuple[float, ...]  # m/s^2
    joints: Mapping[str, float]  # rad, m


def book_systems() -> dict[str, System]:
    """Return the robots that come with the package, by name.

    Gravity and where they begin are those of the scenario whose name a robot's begins with:
    planar mechanisms move in X-Y and have gravity along -Y.
    """
    config = share_directory() / 'config'
    scenarios = {file.stem: read_yaml(file) for file in (config / 'scenarios').glob('*.yaml')}
    systems = {}
    for file in sorted((config / 'robots').glob('*.urdf')):
        named = [stem for stem in scenarios if file.stem.startswith(stem)]
        scenario = scenarios[max(named, key=len)] if named else {}
        gravity = tuple(scenario.get('gravity', EARTH))
        systems[file.stem] = System(file, gravity, scenario.get('start', {}).get('joints', {}))
    return systems


def _open_browser(address: str) -> None:
    """Open a browser where there is a display to show it on."""
    if os.environ.get('DISPLAY') or os.environ.get('WAYLAND_DISPLAY') or sys.platform == 'darwin':
        webbrowser.open(address)


def _ending() -> threading.Event:
    ending = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: ending.set())
    return ending
