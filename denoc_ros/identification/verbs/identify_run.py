"""`denoc identify RUN`: what a recorded run tells of a robot, and the robot with these numbers."""

from __future__ import annotations

import argparse
from pathlib import Path

from denoc_ros.cli.arguments import (
    add_gravity,
    add_json,
    add_option,
    add_output,
    add_overrides,
    add_phase,
    overridden,
)
from denoc_ros.cli.progress import Progress
from denoc_ros.cli.recorded_robot import robot_source
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import BagError
from denoc_ros.identification.model.sources import RecordingSettings
from denoc_ros.identification.pages.identify_run_page import run_page, run_text
from denoc_ros.identification.run_numbers import RunNumbers, identify, run_document
from denoc_ros.identification.tables.tables import is_table
from denoc_ros.identification.verbs.identify_model import (
    add_recording,
    recording_settings,
    write_applied,
)
from denoc_ros.identification.verbs.identify_options import Action, Fit
from denoc_ros.output_files import require_new
from denoc_ros.simulation.recorded.run_files import find_bag, robot_of_run


def _add_run(parser: argparse.ArgumentParser) -> None:
    add_option(parser, 'run RUN', "a run's directory, a bag, or a table with --robot", type=Path)
    add_phase(parser)
    text = 'where the search starts; default: the robot in the bag'
    add_option(parser, '--robot URDF', text)
    add_option(
        parser,
        '--free PATH',
        'what is looked for, as of `denoc identify model`; default: stiffness and damping of all '
        'beams and, where effort was recorded, a payload at the tip',
        nargs='+',
        action='extend',
    )
    text = 'write the robot with what was found: a new file'
    add_option(parser, '--apply URDF', text, type=Path)
    add_output(parser, 'FOLDER', 'folder for result.yaml and report.html')
    add_json(parser)
    add_gravity(parser, None, "the run's, else 0 0 -9.81")
    add_overrides(parser)
    add_recording(parser)


def _run(
    run: Path,
    phase: list[str],
    free: list[str] | None,
    apply: Path | None,
    robot: tuple[Robot, str | Path],
    recording: RecordingSettings,
) -> Fit:
    start, source = robot
    if apply is not None:
        require_new(apply)
        if not apply.parent.is_dir():
            raise BagError(f'{apply}: --apply must be in a folder that exists, got none')
    with Progress().step('identifying'):
        found = identify(run, start, phases=phase, free=free or (), settings=recording)
    head = [] if apply is None else _applied(apply, source, found)
    return Fit(run_document(found, str(source) if isinstance(source, Path) else ''), head=head)


def _applied(target: Path, source: str | Path, found: RunNumbers) -> list[str]:
    """Write the robot's description with the numbers of the one plant of a run."""
    shown = str(source) if isinstance(source, Path) else 'the robot in the bag'
    return write_applied(target, source, shown, found.single.model)


def _robot(args: argparse.Namespace) -> tuple[Robot, str | Path]:
    """Return the robot where the search starts, and its file or its text."""
    if args.robot is None and is_table(args.run):
        raise BagError(f'{args.run}: a table must come with its robot, --robot, got none')
    source = robot_source(find_bag(args.run), args.robot)
    given = None if args.robot is None else source
    return overridden(robot_of_run(args.run, given, args.gravity, True), args), source


DECLARED = (
    Action(
        'run',
        'Find stiffness and damping of all beams and the payload of the robot that a run '
        'recorded, phase by phase, and the modes of every free decay. Exit status: 0 the numbers '
        'that the robot needs for its motion are found, 2 doubtful, 3 some are not identifiable.',
        _add_run,
        _run,
        run_text,
        run_page,
        {'robot': _robot, 'recording': recording_settings},
    ),
)
