"""`denoc identify apply`, `compare`, `postures`: results into robots, compared, as a table."""

from __future__ import annotations

import argparse
import dataclasses
import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from denoc_ros.cli.arguments import require
from denoc_ros.cli.exit_statuses import DOUBTFUL
from denoc_ros.cli.identify_inputs import add_robot_options, joint_values, load_named_robot
from denoc_ros.cli.verbs import ACTIONS
from denoc_ros.control.mode_table import ModeTable
from denoc_ros.errors import ConfigError, IdentificationError
from denoc_ros.identification.apply import joint_overrides, modal_overrides
from denoc_ros.identification.compare import compare_results
from denoc_ros.identification.modes import DOUBTFUL as DOUBTFUL_MODE
from denoc_ros.identification.modes import GOOD
from denoc_ros.identification.result import read_result
from denoc_ros.model.overrides import edited_description
from denoc_ros.output_files import require_new, write_text
from denoc_ros.reports.text_table import text_table

Document = dict[str, Any]


def add_actions(actions: Any) -> None:
    """Declare the actions' arguments."""
    apply = actions.add_parser(
        'apply',
        help=ACTIONS['apply'],
        description=(
            'Compute the damping with which the robot has the identified modes, and write it '
            'into its <flexibility> block; or write the friction of a joint into its '
            '<dynamics>. Nothing else in the file changes. Several results of modes are '
            'combined.'
        ),
    )
    apply.add_argument(
        'results', metavar='RESULT', nargs='+', type=Path, help='a result.yaml, or its folder'
    )
    apply.add_argument('--robot', metavar='URDF', required=True, help='URDF file of the robot')
    apply.add_argument(
        '-o',
        '--output',
        metavar='URDF',
        type=Path,
        required=True,
        help='URDF file to write, must not exist',
    )
    apply.add_argument('--joint', default='', help='joint to which the friction belongs')
    apply.add_argument('--doubtful', action='store_true', help='use doubtful modes too')
    apply.add_argument('--json', action='store_true', help='print machine-readable JSON')
    add_robot_options(apply, robot=False)
    apply.set_defaults(act=run_apply)
    compare = actions.add_parser(
        'compare',
        help=ACTIONS['compare'],
        description=(
            'Compare the modes of several results: mean, standard deviation between runs, '
            'largest difference of two runs in 95 %% of cases. Exit status 2 if runs differ by'
            ' more than their intervals allow.'
        ),
    )
    compare.add_argument(
        'results', metavar='RESULT', nargs='+', type=Path, help='a result.yaml, or its folder'
    )
    compare.add_argument('--json', action='store_true', help='print machine-readable JSON')
    compare.set_defaults(act=run_compare)
    postures = actions.add_parser(
        'postures',
        help=ACTIONS['postures'],
        description=(
            'Write the modes of several results, one posture each, into the table that '
            '`denoc shape --mode-table` and the shaper node (`mode_table`) read. The robot '
            'needs no beams. A result has the posture of `--at` or of the joint states of its '
            'bag, and the modes that its verdict is of (`--band`, `--modes`). Exit status 2 if '
            'one of them is doubtful.'
        ),
    )
    postures.add_argument(
        'results', metavar='RESULT', nargs='+', type=Path, help='a result.yaml, or its folder'
    )
    postures.add_argument(
        '-o',
        '--output',
        metavar='FILE',
        type=Path,
        required=True,
        help='table of modes to write (.yaml), must not exist',
    )
    postures.add_argument('--doubtful', action='store_true', help='use doubtful modes too')
    postures.add_argument('--json', action='store_true', help='print machine-readable JSON')
    postures.set_defaults(act=run_postures)


def run_apply(args: argparse.Namespace) -> int:
    """Write the changed description; errors are raised."""
    require_new(args.output)
    results = [read_result(path) for path in args.results]
    overrides, text = changed_description(args, results)
    write_text(args.output, text)
    if args.json:
        print(json.dumps({'output': str(args.output), 'overrides': overrides}, indent=2))
    else:
        print(f'{args.output}: {args.robot} with')
        for path, value in overrides.items():
            listed = value if isinstance(value, list) else [value]
            print(f'  {path}: {" ".join(f"{number:.6g}" for number in listed)}')
    return 0


def changed_description(
    args: argparse.Namespace, results: Sequence[Mapping[str, Any]]
) -> tuple[dict[str, Any], str]:
    """Return the numbers that change, by dotted path, and the description with them."""
    overrides: dict[str, Any] = {}
    robot = load_named_robot(args.robot, args.gravity)
    modal = [one for one in results if one['kind'] == 'modal']
    of_joint = [one for one in results if one['kind'] == 'joint']
    if modal:
        recorded = modal[0].get('model', {}).get('joints', {})
        joints = {name: recorded[name] for name in robot.joint_names if name in recorded}
        joints |= joint_values(args.at)
        held = args.joints == 'held'
        overrides |= modal_overrides(robot, modal, joints, held, args.doubtful)[0]
    if of_joint:
        if args.joint not in robot.joint_names or len(of_joint) > 1:
            raise IdentificationError(
                f'apply: --joint must name one of {", ".join(robot.joint_names)} for one result '
                f'of a joint, got {args.joint!r} for {len(of_joint)}'
            )
        overrides |= joint_overrides(of_joint[0], args.joint)
    if not overrides:
        raise IdentificationError('apply: results must be of modes or of a joint, got others')
    return overrides, edited_description(robot.tree.source, overrides)


def run_compare(args: argparse.Namespace) -> int:
    """Compare; exit status 2 when runs differ by more than their intervals let expect."""
    compared = compare_results([read_result(path) for path in args.results])
    rows = [
        {
            'f [Hz]': mode.frequency_hz,
            'runs': f'{len(mode.runs)} of {len(args.results)}',
            'zeta': mode.damping_ratio,
            'deviation': _finite(mode.damping_deviation),
            'expected': mode.expected_deviation,
            'repeatability': _finite(mode.repeatability),
            'of zeta': _percent(mode.repeatability / mode.damping_ratio),
            'consistent': 'yes' if mode.consistent else 'no',
        }
        for mode in compared
    ]
    if args.json:
        modes = [{**dataclasses.asdict(mode), 'consistent': mode.consistent} for mode in compared]
        finite = [
            {key: _finite(v) if isinstance(v, float) else v for key, v in mode.items()}
            for mode in modes
        ]
        print(json.dumps({'results': list(map(str, args.results)), 'modes': finite}, indent=2))
    elif rows:
        print(text_table(rows))
    return 0 if all(mode.consistent for mode in compared) else DOUBTFUL


def run_postures(args: argparse.Namespace) -> int:
    """Write the table; exit status 2 where a doubtful mode is in it."""
    require_new(args.output)
    if args.output.suffix not in ('.yaml', '.yml'):
        raise ConfigError('postures', [f'--output must end in .yaml, got {args.output.name!r}'])
    results = [(path, read_result(path)) for path in args.results]
    rows = [_posture_row(path, result, args.doubtful) for path, result in results]
    findings = [
        f'{path}: must have the joints and as many modes as {args.results[0]} '
        f'({len(rows[0][1])} of {", ".join(rows[0][0])}), got {len(row[1])} of {", ".join(row[0])}'
        for path, row in zip(args.results, rows, strict=True)
        if row[0].keys() != rows[0][0].keys() or len(row[1]) != len(rows[0][1])
    ]
    require(findings)
    joints = tuple(rows[0][0])
    table = ModeTable(
        joints,
        np.array([[posture[name] for name in joints] for posture, _ in rows]),
        np.array([[mode['frequency_hz'] for mode in modes] for _, modes in rows]),
        np.array([[mode['damping_ratio'] for mode in modes] for _, modes in rows]),
        str(args.output),
    )
    values = table.text_values()
    write_text(args.output, yaml.safe_dump(values, sort_keys=False, default_flow_style=None))
    if args.json:
        print(json.dumps({'output': str(args.output), **values}, indent=2))
    else:
        print(
            text_table(
                [
                    {
                        **{name: f'{posture[name]:.4g}' for name in joints},
                        'f [Hz]': ' '.join(f'{mode["frequency_hz"]:.4g}' for mode in modes),
                        'zeta': ' '.join(f'{mode["damping_ratio"]:.4g}' for mode in modes),
                    }
                    for posture, modes in rows
                ]
            )
        )
        print(f'{len(rows)} postures in {args.output}')
    good = all(mode['verdict'] == GOOD for _, modes in rows for mode in modes)
    return 0 if good else DOUBTFUL


def _posture_row(
    path: Path, result: Mapping[str, Any], with_doubtful: bool
) -> tuple[dict[str, float], list[Mapping[str, Any]]]:
    """Return where the joints stood, and the modes that a result's verdict is of, ascending."""
    joints = result.get('model', {}).get('joints', {})
    if result['kind'] != 'modal' or not joints:
        raise IdentificationError(
            f'{path}: result must be of `denoc identify modal` with a posture (--at JOINT=VALUE, '
            f'or joint states in the bag), got one without'
        )
    asked = [mode for mode in result['modes'] if mode.get('asked')]
    usable = (GOOD, DOUBTFUL_MODE) if with_doubtful else (GOOD,)
    bad = [mode for mode in asked if mode['verdict'] not in usable]
    if bad or not asked:
        said = ', '.join(f'{mode["frequency_hz"]:.4g} Hz: {mode["verdict"]}' for mode in bad)
        is_doubtful = bad and all(mode['verdict'] == DOUBTFUL_MODE for mode in bad)
        hint = ': --doubtful takes them' if is_doubtful else ''
        raise IdentificationError(
            f'{path}: modes must be {" or ".join(usable)}, got {said or "none"}{hint}'
        )
    return dict(joints), sorted(asked, key=lambda mode: float(mode['frequency_hz']))


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _percent(value: float) -> str:
    return f'{100.0 * value:.2g} %' if math.isfinite(value) else '-'
