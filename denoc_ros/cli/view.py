"""`denoc view`: a page in the browser that shows a robot, a run, or the book's systems."""

from __future__ import annotations

import argparse
import os
import signal
import sys
import threading
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from denoc_ros.dynamics.robot import Robot
    from denoc_ros.viewer.page import Page

DEFAULT_PORT = 8080
STANDARD_GRAVITY = (0.0, 0.0, -9.81)
FIRST = 'canadarm'  # that the gallery shows


def add_parser(subparsers: Any) -> None:
    """Declare the verb's arguments."""
    parser = subparsers.add_parser(
        'view',
        help='show a robot in the browser: bent links, forces, natural modes',
        description='Serve a page that shows a robot as it bends, on this machine only unless '
        '--host says otherwise, until interrupted. Without a robot: a gallery of the systems in '
        'the book.',
    )
    parser.add_argument('robot', nargs='?', help='a URDF file; default the gallery')
    parser.add_argument(
        '--gravity',
        nargs=3,
        type=float,
        metavar=('X', 'Y', 'Z'),
        help='in the base frame [m/s^2], default 0 0 -9.81',
    )
    parser.add_argument(
        '--scale', type=float, default=1.0, help='what deflections are drawn larger by, 1 to 100'
    )
    parser.add_argument('--host', default='127.0.0.1', help='interface to listen on')
    parser.add_argument(
        '--port', type=int, default=DEFAULT_PORT, help='0 takes a free one; default %(default)s'
    )
    parser.add_argument(
        '--no-browser', action='store_true', help='open no browser, where there is a display'
    )


def run(args: argparse.Namespace) -> int:
    """Run the verb and return the exit status; errors are raised."""
    from denoc_ros.errors import ConfigError
    from denoc_ros.viewer.page import LOOPBACK

    if not 1.0 <= args.scale <= 100.0:
        raise ConfigError('denoc view', [f'--scale must be 1 to 100, got {args.scale:g}'])
    with _gallery(args) if args.robot is None else _robot_page(args) as page:
        if args.host not in LOOPBACK:
            print(
                f'denoc view: warning: the page is served beyond this machine ({args.host}): '
                'whoever reaches it can look and move the controls',
                file=sys.stderr,
            )
        print(f'open {page.address} (end with Ctrl-C)', flush=True)
        if not args.no_browser:
            _open_browser(page.address)
        _wait()
    return 0


def _robot_page(args: argparse.Namespace) -> Page:
    from denoc_ros.cli.config import find_file
    from denoc_ros.dynamics.robot import load_robot

    file = find_file(Path(args.robot), Path()) or Path(args.robot)
    robot = load_robot(file, gravity=args.gravity or STANDARD_GRAVITY)
    page = _serve(args, robot, folder=file.parent)
    page.pose()
    return page


def _gallery(args: argparse.Namespace) -> Page:
    from denoc_ros.dynamics.robot import load_robot
    from denoc_ros.viewer.gallery import offer

    systems = book_systems()

    def load(name: str) -> Robot:
        path, gravity = systems[name]
        return load_robot(path, gravity=args.gravity or gravity)

    page = _serve(args, load(FIRST), title='denoc_ros: systems of the book')
    offer(page, list(systems), FIRST, load)
    return page


def _serve(args: argparse.Namespace, robot: Robot, **options: Any) -> Page:
    from denoc_ros.viewer.page import Page

    return Page(robot, args.host, args.port, scale=args.scale, **options)


def book_systems() -> dict[str, tuple[Path, tuple[float, ...]]]:
    """Return the robots that come with the package: name to file and gravity [m/s^2].

    Gravity is that of the scenario whose name a robot's begins with: planar mechanisms move in
    X-Y and have it along -Y.
    """
    from denoc_ros.cli.config import read_yaml, share_directory

    config = share_directory() / 'config'
    gravities = {
        file.stem: read_yaml(file).get('gravity', STANDARD_GRAVITY)
        for file in sorted((config / 'scenarios').glob('*.yaml'))
    }
    systems = {}
    for file in sorted((config / 'robots').glob('*.urdf')):
        named = [stem for stem in gravities if file.stem.startswith(stem)]
        gravity = gravities[max(named, key=len)] if named else STANDARD_GRAVITY
        systems[file.stem] = file, tuple(gravity)
    return systems


def _open_browser(address: str) -> None:
    """Open a browser where there is a display to show it on."""
    if os.environ.get('DISPLAY') or os.environ.get('WAYLAND_DISPLAY') or sys.platform == 'darwin':
        import webbrowser

        webbrowser.open(address)


def _wait() -> None:
    """Return at SIGINT or SIGTERM."""
    ending = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: ending.set())
    ending.wait()
