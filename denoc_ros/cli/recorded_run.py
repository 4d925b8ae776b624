"""A recorded run as the command line names it: bag, robot, and the part to use."""

from __future__ import annotations

import argparse
import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from denoc_ros.bags.reader import read_description
from denoc_ros.cli.config import find_file
from denoc_ros.dynamics.robot import Robot, load_robot
from denoc_ros.errors import BagError, ConfigError
from denoc_ros.reports.run_files import EARTH, find_bag, plant_of, read_session, recording_name

if TYPE_CHECKING:  # an optional extra
    from denoc_ros.viewer.recorded import RecordedRun

SOURCES = ('plant', 'predictor', 'replay', 'joints')


@dataclass(frozen=True)
class OpenedRun:
    """A run and its robot.

    Attributes
    ----------
    run : RecordedRun
    robot : Robot
    title : str
        The robot's name and the run's.
    folder : Path or None
        Where relative names of the robot's mesh files start, where it came from a file.
    """

    run: RecordedRun
    robot: Robot
    title: str
    folder: Path | None


def add_run_options(parser: argparse.ArgumentParser) -> None:
    """Declare the options that select a part of a run, and its robot."""
    group = parser.add_argument_group('a recorded run')
    group.add_argument(
        '--robot', help=(
            'URDF file of the robot, in this folder or in the installed package; default: the '
            'one in the bag'
        ),
    )  # fmt: skip
    group.add_argument(
        '--source',
        choices=SOURCES,
        default='',
        help='source of the deflection; default: the first of these in the bag',
    )
    group.add_argument(
        '--from',
        dest='start',
        type=float,
        metavar='S',
        default=-math.inf,
        help='first time to show [s]',
    )
    group.add_argument(
        '--to',
        dest='end',
        type=float,
        metavar='S',
        default=math.inf,
        help='last time to show [s]',
    )


def open_run(args: argparse.Namespace, path: Path, rate: float) -> OpenedRun:
    """Open a run.

    Parameters
    ----------
    args : Namespace
        Of `add_run_options`, and `gravity`.
    path : Path
        A bag, or the directory of a run.
    rate : float
        Moments per second, at most.

    Raises
    ------
    BagError, ConfigError, ModelError
        The run cannot be read, or not with this robot.
    """
    from denoc_ros.viewer.recorded import RecordedRun

    if not args.start < args.end:
        raise ConfigError(
            '--to', [f'it must be beyond --from, got {args.start:g} to {args.end:g}']
        )
    bag, session = find_bag(path), read_session(path)
    source = robot_source(bag, args.robot)
    robot = load_robot(source, gravity=args.gravity or session.get('gravity', EARTH))
    if args.source in ('', 'plant'):
        robot = plant_of(robot, session)
    run = RecordedRun(bag, robot, args.source, args.start, args.end, rate)
    file = source if isinstance(source, Path) else _session_robot(session)
    name = session.get('name') or recording_name(path)
    title = robot.tree.name if name == robot.tree.name else f'{robot.tree.name}: {name}'
    return OpenedRun(run, robot, title, file.parent if file is not None else None)


def robot_source(bag: Path, given: str | None) -> str | Path:
    """Return the file of the robot that was given, else the text of the recorded one.

    Raises
    ------
    BagError
        None was given and the bag has none.
    """
    if given is not None:
        return find_file(Path(given), Path()) or Path(given)
    if text := read_description(bag):
        return text
    raise BagError(f'{bag}: bag must hold the robot where --robot is not given, got none')


def _session_robot(session: dict[str, object]) -> Path | None:
    """Return the file that the run's robot came from, for the meshes beside it."""
    file = Path(str(session.get('robot', '')))
    return file if file.is_file() else None
