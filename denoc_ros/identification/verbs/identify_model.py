"""`denoc identify model` and `excite`: a robot's numbers from recorded runs, and their motion."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from denoc_ros.bags.digest import file_hash
from denoc_ros.cli.arguments import (
    WINDOW,
    add_gravity,
    add_json,
    add_number,
    add_option,
    add_output,
    add_overrides,
    add_pairs,
    add_settings,
    default_of,
    given_file,
    number_range,
    overridden,
    overrides_of,
    require,
    settings_of,
    window_findings,
)
from denoc_ros.cli.many_runs import WorkerConfig, add_worker_options, worker_config
from denoc_ros.cli.motion_file import write_joint_trajectory, write_points
from denoc_ros.cli.progress import Progress, share_bar
from denoc_ros.cli.verb_result import VerbResult
from denoc_ros.cli.verbs import exit_status
from denoc_ros.dynamics.robot import Robot, load_robot
from denoc_ros.errors import BagError
from denoc_ros.identification.model.excitation import design_excitation
from denoc_ros.identification.model.free_parameters import FreeParameters
from denoc_ros.identification.model.model_fit import IdentifiedModel, identify_model
from denoc_ros.identification.model.model_result import (
    ModelOptions,
    applied_description,
    excitation_result,
    not_applied,
)
from denoc_ros.identification.model.sources import RecordingSettings, SensorFilter
from denoc_ros.identification.pages.identify_numbers import (
    excitation_page,
    excitation_text,
    model_page,
    model_text,
)
from denoc_ros.identification.verbs.identify_options import Action, Fit
from denoc_ros.identification.verbs.identify_rows import RowKind, recordings, rows_result
from denoc_ros.output_files import require_new, write_text
from denoc_ros.pages.provenance import named_file
from denoc_ros.simulation.recorded.run_files import EARTH, read_session
from denoc_ros.text_table import Row

OF_NUMBER: dict[str, type] = {'': float, ' from': float, ' to': float, ' verdict': str}
MARKS = {'found': '', 'doubtful': '?', 'not identifiable': '-'}
LIMITS = {
    'velocity': ('JOINT=VALUE', 'largest velocity of a joint [rad/s, m/s]'),
    'acceleration': ('JOINT=VALUE', 'largest acceleration of a joint [rad/s^2, m/s^2]'),
    'effort': ('JOINT=VALUE', 'largest effort of a joint [N m, N]'),
    'deflection': (
        'LINK=VALUE',
        "largest deflection of a flexible link's tip [m]; default: a tenth of its length",
    ),
}


def _add_model(parser: argparse.ArgumentParser) -> None:
    add_option(
        parser,
        'bags BAG',
        "recorded runs: bags, tables, folders of them, or 'bags/**/*.mcap'",
        nargs='+',
    )
    add_option(parser, '--robot URDF', 'where the search starts', required=True)
    add_option(
        parser,
        '--free PATH',
        'what is free: beam.<link>.<y|z>.ei, beam.<link>.torsion.gj, '
        'beam.<link>.<part>.damping_ratio, '
        'joint.<joint>.<stiffness|damping|friction|armature>, payload.<link>, '
        'link.<link>.inertial, sensor.<name>.<gain|offset>, '
        'effort.<joint>.<gain|offset>, pose.<frame>.offset, delay.effort, '
        'delay.<sensor>, delay.pose.<frame>; * stands for any name',
        nargs='+',
        action='extend',
        required=True,
    )
    add_gravity(parser, None, "the first run's, else 0 0 -9.81")
    add_overrides(parser)
    text = 'bandwidth above which effort is not compared'
    add_number(parser, '--cutoff HZ', default_of(identify_model, 'cutoff'), text, 'Hz')
    text = 'last part of each run that a first fit does not see and is judged by'
    add_number(parser, '--held-out PART', default_of(identify_model, 'held_out'), text)
    _add_outputs(parser)
    add_recording(parser)
    add_worker_options(parser)


def _add_outputs(parser: argparse.ArgumentParser) -> None:
    add_option(
        parser, '--apply URDF', 'write the robot with what was found: a new file', type=Path
    )
    add_output(
        parser,
        'FOLDER',
        'folder for result.yaml and report.html, or with --each for Parquet files',
    )
    add_json(parser)
    add_option(
        parser,
        '--each',
        'fit each recording on its own: one row each, as of the robots of a fleet; so do '
        '--workers and --scheduler',
    )


def add_recording(parser: argparse.ArgumentParser) -> None:
    """Declare the options that say how a recording is read."""
    group = parser.add_argument_group('the recordings')
    for option, dest, read, text in (
        (
            '--rename OLD=NEW',
            None,
            str,
            'beginning of joint names in the bag, and its replacement in the robot',
        ),
        (
            '--column NAME=COLUMN',
            'columns',
            str,
            "column of a table: JOINT.position, JOINT.velocity, JOINT.effort, or a sensor's "
            'raw readings as sensor.NAME',
        ),
        (
            '--torque-constant JOINT=NM_PER_A',
            'torque_constants',
            float,
            "torque per ampere at the joint, where the joint's effort was recorded as "
            'current; negative where current turns it the other way',
        ),
        (
            '--filter SENSOR=OMEGA,DAMPING',
            'filters',
            _two_numbers,
            "low-pass of second order that a sensor's readings have passed [rad/s, share of "
            'critical]',
        ),
        (
            '--pose TOPIC=FRAME',
            'poses',
            str,
            'poses (geometry_msgs/PoseStamped) that a tracker measured of a frame of the '
            "robot, in axes near those of the robot's base",
        ),
    ):
        add_pairs(group, option, text, read, dest)
    add_settings(group, RecordingSettings, '--topic', *WINDOW)


def recording_settings(args: argparse.Namespace) -> RecordingSettings:
    """Settings by the options; ConfigError with every finding."""
    require(window_findings(args))
    filters = {name: SensorFilter(*pair) for name, pair in args.filters.items()}
    return settings_of(RecordingSettings, args, filters=filters)


def _two_numbers(text: str) -> tuple[float, float]:
    first, second = text.split(',')
    return float(first), float(second)


def _recorded_gravity(run: str) -> Sequence[float]:
    """Return the gravity of a recorded run [m/s^2]."""
    path = Path(run)
    found: Sequence[float] = (read_session(path) if path.exists() else {}).get('gravity', EARTH)
    return found


def model_options(args: argparse.Namespace) -> ModelOptions:
    """Return the options of `denoc identify model`; ConfigError with every finding.

    The robot's file is named as a whole: workers may have another working directory.
    """
    return ModelOptions(
        robot=args.robot,
        file=given_file(args.robot, 'robot').resolve(),
        gravity=tuple(args.gravity or _recorded_gravity(args.bags[0])),
        overrides=overrides_of(args.set, args.payload),
        recording=recording_settings(args),
        free=args.free,
        cutoff=args.cutoff,
        held_out=args.held_out,
    )


def _model(
    bags: list[str],
    apply: Path | None,
    each: bool,
    output: Path | None,
    json: bool,
    workers: WorkerConfig,
    options: ModelOptions,
) -> Fit | VerbResult:
    if apply is not None and apply.exists():
        raise BagError(f'{apply}: --apply must be a new file, got an existing one')
    paths, each = recordings(bags), each or workers != WorkerConfig()
    if each and apply is not None:
        raise BagError('--apply must come with one model, got --each, --workers or --scheduler')
    if each:
        return rows_result(model_rows(options), options, paths, output, workers, not json)
    with Progress().step('identifying'):
        document, found = options.identify(paths)
    head = [] if apply is None else write_applied(apply, options.file, options.robot, found)
    return Fit(document, head=head)


def write_applied(
    target: Path, source: str | Path, shown: str, found: IdentifiedModel
) -> list[str]:
    """Write the robot's description with the found numbers; return the lines that say so.

    Parameters
    ----------
    source : str or Path
        The description where the search began, as text or as a file.
    shown : str
        What lines call it.
    """
    write_text(target, applied_description(source, found))
    return [
        f'{target}: {shown} with what was found',
        *(f'  not identifiable, as in the file: {path}' for path in not_applied(found)),
    ]


def model_rows(options: ModelOptions) -> RowKind:
    """Return which rows the models of recordings make: a column for each free number."""
    paths = FreeParameters(options.start(), options.free).paths
    own: dict[str, type] = {
        **{f'{path}{end}': kind for path in paths for end, kind in OF_NUMBER.items()},
        'held_out': float,
        'not_identifiable': str,
    }
    return RowKind(model_row, own, _shown(paths), file_hash(options.file))


def model_row(item: tuple[ModelOptions, Path]) -> Row:
    """Return the row of the model that one recording tells.

    `held_out` is the largest share of a channel's deviation that is left of the held-out part.
    """
    options, path = item
    document, found = options.identify([path])
    row: Row = {'verdict': document['verdict']}
    for one in document['parameters']:
        values = (one['value'], *one['interval'], one['verdict'])
        row |= {f'{one["path"]}{end}': v for end, v in zip(OF_NUMBER, values, strict=True)}
    left = [one.held_out_after / one.size for one in found.channels if one.size > 0.0]
    return {
        **row,
        'held_out': max(left) if left and options.held_out else None,
        'not_identifiable': '; '.join(document['not_identifiable']),
        'reasons': '; '.join(document['reasons']),
    }


def _shown(paths: Sequence[str]) -> Callable[[Row], Row]:
    """Make a formatter of a row's line: numbers, `?` behind the doubtful, `-` for no number."""

    def line(row: Row) -> Row:
        shown: Row = {}
        for path in paths:
            mark = MARKS[row[f'{path} verdict']]
            shown[path] = mark if mark == '-' else f'{row[path]:.4g}{mark}'
        return shown

    return line


def _add_excite(parser: argparse.ArgumentParser) -> None:
    add_option(parser, 'robot ROBOT', 'the URDF file')
    add_option(
        parser,
        '--free PATH',
        'what is to be identified, as of `denoc identify model`',
        nargs='+',
        action='extend',
        required=True,
    )
    add_output(
        parser,
        '',
        'the motion: a .yaml reference that `denoc up` and `denoc simulate` read',
        required=True,
    )
    add_option(
        parser,
        '--trajectory FILE',
        'also write it as the YAML of a trajectory_msgs/JointTrajectory',
        type=Path,
    )
    add_option(parser, '--page FILE', 'also write an HTML page', type=Path)
    add_json(parser)
    _add_motion(parser)
    _add_limits(parser)
    add_gravity(parser)
    add_overrides(parser)


def _add_motion(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group('motion and recording')
    for option, name, text, unit in (
        ('--duration S', 'duration', 'of the motion', 's'),
        (
            '--harmonics K',
            'harmonics',
            'of each joint: the highest frequency is harmonics / duration',
            '',
        ),
        ('--rate HZ', 'rate', 'of recording', 'Hz'),
        ('--time-limit S', 'time_limit', 'of the search, in processor time', 's'),
        ('--seed K', 'seed', 'of the motions drawn that the search starts from', ''),
    ):
        add_number(group, option, default_of(design_excitation, name), text, unit)
    text = 'between rows of the motion'
    add_number(group, '--interval S', 0.02, text, 's', positive=True, finite=True)
    text = 'where a joint begins and ends [rad, m]; default: 0'
    add_pairs(group, '--start JOINT=VALUE', text, float)
    add_pairs(
        group,
        '--noise CHANNEL=VALUE',
        'standard deviation of a sample of effort, effort.JOINT [N m, N], a sensor, '
        'IMU.gyro [rad/s] or IMU.accel [m/s^2]; inf: not recorded; default: 1 %% of the '
        "effort limit, the sensor's noise",
        float,
    )


def _add_limits(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("limits in place of the URDF's")
    add_pairs(group, '--position JOINT=LOW:HIGH', 'range of a joint [rad, m]', number_range)
    for name, (form, text) in LIMITS.items():
        add_pairs(group, f'--{name} {form}', text, float)


def _excite(
    options: dict[str, Any],
    loaded: tuple[Path, Robot],
    free: list[str],
    interval: float,
    files: tuple[Path, Path | None, Path | None],
    command: str,
    json: bool,
) -> VerbResult:
    (file, robot), (output, trajectory, page) = loaded, files
    with share_bar(json) as bar:
        found = design_excitation(
            robot, free, **options, progress=lambda share: bar.update(share - bar.n)
        )
    rows = found.rows(np.linspace(0.0, found.duration, 1 + math.ceil(found.duration / interval)))
    motion = (rows.q, rows.qd, rows.qdd)
    planned = '# Planned by `denoc identify excite`: from rest to rest, for '
    head = f'{planned}{len(found.values)} free numbers.\n'
    write_points(output, head, found.joints, rows.t, motion)
    if trajectory is not None:
        write_joint_trajectory(trajectory, found.joints, rows.t, motion)
    document = {'output': str(output), 'robot': named_file(file), **excitation_result(found)}
    if page is not None:
        write_text(page, excitation_page(found, document, robot.tree, command).html())
    return VerbResult(document, [excitation_text(document)], exit_status(document['verdict']))


def _excite_options(args: argparse.Namespace) -> dict[str, Any]:
    findings: list[str] = []
    if args.output.suffix not in ('.yaml', '.yml'):
        findings.append(f'--output must end in .yaml, got {args.output.name!r}')
    require(findings)
    require_new(args.output, args.trajectory, args.page)
    always = ('duration', 'harmonics', 'rate', 'time_limit', 'seed')
    where_given = ('start', 'noise', 'position', *LIMITS)
    given = [name for name in where_given if getattr(args, name)]
    return {name: getattr(args, name) for name in (*always, *given)}


def _loaded(args: argparse.Namespace) -> tuple[Path, Robot]:
    """Return the robot's file and the robot with the options' numbers."""
    file = given_file(args.robot, 'robot')
    return file, overridden(load_robot(file, gravity=tuple(args.gravity)), args)


DECLARED = (
    Action(
        'model',
        'Fit numbers of the robot to measured effort, gauges and other sensors of one run or '
        'several, by maximum likelihood. For each number: its value, a 95 %% interval, and '
        'whether it is found, doubtful or not identifiable; and which combinations are '
        'identifiable where single numbers are not.',
        _add_model,
        _model,
        model_text,
        model_page,
        {'options': model_options, 'workers': worker_config},
    ),
    Action(
        'excite',
        'Find the motion within limits, a Fourier series of each joint from rest to rest, whose '
        'recording tells `denoc identify model` most of the free numbers; print the 95 %% '
        'intervals to expect, and what no motion shows.',
        _add_excite,
        _excite,
        settings={
            'options': _excite_options,
            'loaded': _loaded,
            'files': lambda args: (args.output, args.trajectory, args.page),
        },
    ),
)
