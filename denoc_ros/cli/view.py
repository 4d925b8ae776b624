"""`denoc view`: a page in the browser that shows a robot, a run, or the book's systems; films."""

from __future__ import annotations

import argparse
import os
import signal
import sys
import threading
import webbrowser
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from denoc_ros.cli.arguments import add_gravity
from denoc_ros.cli.config import find_file, read_yaml, share_directory
from denoc_ros.cli.film import add_film_options, wants_pictures, write_pictures
from denoc_ros.cli.recorded_run import add_run_options, open_run
from denoc_ros.cli.verbs import VERBS
from denoc_ros.dynamics.robot import Robot, load_robot
from denoc_ros.errors import ConfigError, DenocError
from denoc_ros.reports.run_files import EARTH

if TYPE_CHECKING:  # an optional extra
    from denoc_ros.viewer.page import Page

DEFAULT_PORT = 8080
FIRST = 'canadarm'  # that the gallery shows
BAG_SUFFIXES = ('.mcap', '.db3')
PAGE_RATE = 60.0  # moments per second of a run, at most


def add_parser(subparsers: Any) -> None:
    """Declare the verb's arguments."""
    parser = subparsers.add_parser(
        'view',
        help=(VERBS['view']),
        description=(
            'Serve a page that shows the deformed robot until interrupted, on this machine '
            'only unless --host allows more. Without a robot: a gallery of the systems in the '
            'book. With --video or --strip: write a film or a picture of a run instead.'
        ),
    )
    parser.add_argument(
        'shown',
        nargs='?',
        metavar='ROBOT|RUN',
        help="a URDF file, a bag, or a run's directory; default: the gallery",
    )
    add_gravity(parser, None, "the run's, else 0 0 -9.81")
    parser.add_argument(
        '--scale',
        type=float,
        help=(
            'factor that enlarges deflections, 1 to 100; default 1, for films chosen so that '
            'they are visible'
        ),
    )
    parser.add_argument('--host', default='127.0.0.1', help='interface to listen on')
    parser.add_argument(
        '--port',
        type=int,
        default=DEFAULT_PORT,
        help='port of the page, 0 for a free one; default %(default)s',
    )
    parser.add_argument('--no-browser', action='store_true', help='do not open a browser')
    add_run_options(parser)
    add_film_options(parser)


def run(args: argparse.Namespace) -> int:
    """Run the verb and return the exit status; errors are raised."""
    if args.scale is not None and not 1.0 <= args.scale <= 100.0:
        raise ConfigError('denoc view', [f'--scale must be 1 to 100, got {args.scale:g}'])
    run_path = Path(args.shown) if args.shown is not None and is_run(args.shown) else None
    if wants_pictures(args):
        if run_path is None:
            raise ConfigError(
                '--video, --strip',
                [f'a run must be given, a bag or a directory, got {args.shown}'],
            )
        for file in write_pictures(args, run_path):
            print(file)
        return 0
    return _serve_until_interrupted(args, run_path)


def is_run(path: str) -> bool:
    """Say whether a path is that of a run, not of a robot."""
    return Path(path).is_dir() or Path(path).suffix in BAG_SUFFIXES


def _serve_until_interrupted(args: argparse.Namespace, run_path: Path | None) -> int:
    from denoc_ros.viewer import NO_VISER

    try:
        from denoc_ros.viewer.page import LOOPBACK
    except ImportError as error:
        raise DenocError(NO_VISER.format(error)) from error
    with _page(args, run_path) as page:
        if args.host not in LOOPBACK:
            print(
                f'denoc view: warning: the page is served beyond this machine ({args.host}): '
                'everybody who reaches it can watch and move the controls',
                file=sys.stderr,
            )
        ending = _ending()
        print(f'open {page.address} (end with Ctrl-C)', flush=True)
        if not args.no_browser:
            _open_browser(page.address)
        ending.wait()
    return 0


def _page(args: argparse.Namespace, run_path: Path | None) -> Page:
    if run_path is not None:
        return _run_page(args, run_path)
    return _gallery(args) if args.shown is None else _robot_page(args)


def _run_page(args: argparse.Namespace, path: Path) -> Page:
    opened = open_run(args, path, PAGE_RATE)
    page = _serve(args, opened.robot, title=opened.title, folder=opened.folder)
    page.play(opened.run)
    return page


def _robot_page(args: argparse.Namespace) -> Page:
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
    """Make an event that SIGINT and SIGTERM set."""
    ending = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: ending.set())
    return ending
