"""`denoc shape ROBOT MOTION -o PLAN`: a motion without residual vibration, and its page."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from denoc_ros.cli.arguments import (
    add_gravity,
    add_json,
    add_number,
    add_option,
    add_output,
    add_overrides,
    add_pairs,
    add_settings,
    field_of,
    given_file,
    overrides_of,
    require,
)
from denoc_ros.cli.motion_file import read_motion, write_plan
from denoc_ros.cli.progress import share_bar
from denoc_ros.cli.session.session_config import flatten, read_yaml
from denoc_ros.cli.verb_result import VerbResult
from denoc_ros.dynamics.base.reacting_base import held_robot
from denoc_ros.dynamics.driven.motion_plan import Plan
from denoc_ros.dynamics.robot import Robot, load_robot
from denoc_ros.errors import ConfigError
from denoc_ros.output_files import require_new, write_text
from denoc_ros.pages.html_page import engineering
from denoc_ros.pages.provenance import named_file, provenance
from denoc_ros.planning.rest.joint_plans import RestOptions, ShaperOptions
from denoc_ros.planning.shape_motion import BASES, OPTIONS, shape_motion
from denoc_ros.planning.shape_page import compare, page
from denoc_ros.planning.shaper_parameters import OF_STREAMS
from denoc_ros.planning.timing.limit_rows import BEAMS, JOINTS, LimitOptions
from denoc_ros.planning.tip.tip_options import TipOptions
from denoc_ros.simulation.recorded.run_files import EARTH

LEAST_GAIN = 1e-5  # of the duration: smaller gains are not listed
OF_LIMITS = (
    '--tip-speed X', '--tip-acceleration X', '--power X', '--margin SHARE', '--uncertainty SHARE',
)  # fmt: skip
OF_TIP = ('--stretch X', '--preaction S', '--postaction S', '--turn M', '--step S', '--pieces N')
OF_REST = ('--duration S', '--robustness SHARE', '--radius M')
PLANNED = tuple(map(field_of, (*OF_LIMITS, *OF_TIP, '--modes', *OF_REST)))
DESCRIPTION = (
    'Plan the motion of the joints so that the tip of a flexible robot moves like that of the '
    'undeformed robot, or so that no vibration is left at the end. The plan is a reference that '
    '`denoc up` and `denoc simulate` read.'
)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    add_option(parser, 'robot', 'the URDF file')
    add_option(
        parser,
        'motion',
        'a YAML file: a reference, a scenario or configuration that has one, or a '
        'trajectory_msgs/JointTrajectory',
    )
    add_output(
        parser,
        '',
        'the plan: .yaml for a reference of the joints, .csv for a table of all quantities',
        required=True,
    )
    add_option(
        parser, '--method', 'method of planning; default: tip', 'tip', choices=tuple(OPTIONS)
    )
    add_option(parser, '--tip FRAME', 'frame to keep on its path; repeatable', action='append')
    add_option(
        parser,
        '--base',
        'of a robot whose base floats: it reacts to the arm, or thrusters hold it; '
        'default: free_floating',
        choices=BASES,
    )
    add_option(parser, '--page FILE', 'also simulate the plan and write an HTML page', type=Path)
    add_option(
        parser,
        '--fastest',
        'method tip and rest_to_rest: the timing is free, in the least time within the limits',
    )
    add_json(parser)
    add_number(parser, '--interval S', 0.02, 'time between rows', 's', positive=True, finite=True)
    add_gravity(parser, None, "the motion file's, else 0 0 -9.81")
    add_overrides(parser)
    _add_limits(parser)
    _add_method_options(parser)


def _add_limits(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("limits in place of the file's")
    add_option(group, '--joint-limits FILE', "joint_limits.yaml, as MoveIt's configurations have")
    for whose, limits in {'joint': JOINTS, 'link': BEAMS}.items():
        for name, unit in limits.items():
            option = f'--{name.replace("_", "-")} {whose.upper()}=VALUE'
            add_pairs(group, option, f'largest {name.replace("_", " ")} [{unit}]', float)
    add_settings(group, LimitOptions, *OF_LIMITS, unset=True)


def _add_method_options(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group('method tip')
    add_option(group, '--joints NAME,…', 'the driven joints; default: all but mimic joints')
    add_settings(group, TipOptions, *OF_TIP, unset=True)
    group = parser.add_argument_group('method rest_to_rest')
    add_settings(group, RestOptions, *OF_REST, unset=True)
    group = parser.add_argument_group('input shapers and rest to rest')
    add_settings(group, ShaperOptions, '--modes N', unset=True)
    add_option(
        group,
        '--mode-table FILE',
        'measured modes over postures (`denoc identify postures`) in place of those of '
        'the model, which may be rigid (zv, zvd, ei)',
    )


def run(args: argparse.Namespace) -> VerbResult:
    """Plan the motion, write it and its page; errors are raised."""
    require(_findings(args))
    require_new(args.output, args.page)
    motion_file = given_file(args.motion, 'motion')
    values = read_yaml(motion_file)
    options = _options(args, values)
    robot = _robot(args, values)
    times, joints = read_motion(values, motion_file, robot.joint_names)
    tip = args.tip or values.get('tip')
    with share_bar(args.json) as bar:
        if hasattr(OPTIONS[args.method], 'progress'):
            options['progress'] = lambda share: bar.update(share - bar.n)
        plan = shape_motion(robot, times, joints, args.method, tip, base=args.base, **options)
    write_plan(plan, args.output, args.interval)
    summary = {'output': str(args.output), **summarize(plan, times)}
    if args.page:
        summary.update(_page(args, robot, plan, (times, joints), tip))
    return VerbResult(summary, _lines(summary))


def _findings(args: argparse.Namespace) -> list[str]:
    found = []
    if args.output.suffix not in ('.yaml', '.yml', '.csv'):
        found.append(f'--output must end in .yaml or .csv, got {args.output.name!r}')
    given = {name: name for name in (*PLANNED, 'joints') if getattr(args, name) is not None}
    if args.fastest:
        given['time'] = 'fastest'
    for name, option in given.items():
        methods = [method for method, kind in OPTIONS.items() if hasattr(kind, name)]
        if args.method not in methods:
            found.append(f'--{option} is for --method {" or ".join(methods)}, got {args.method}')
    if args.mode_table is not None and args.method not in OF_STREAMS:
        found.append(f'--mode-table is for --method zv, zvd or ei, got {args.method}')
    return found


def _options(args: argparse.Namespace, values: Mapping[str, Any]) -> dict[str, Any]:
    options: dict[str, Any] = {}
    if args.joint_limits:
        options.update(read_joint_limits(given_file(args.joint_limits, 'joint limits')))
    for name in (*JOINTS, *BEAMS):
        if given := getattr(args, name):
            options[name] = {**options.get(name, {}), **given}
    if args.fastest:
        options['time'] = 'minimum'
    for name in PLANNED:
        if getattr(args, name) is not None:
            options[name] = getattr(args, name)
    if args.mode_table is not None:
        options['mode_table'] = given_file(args.mode_table, 'mode table')
    if args.joints:
        options['joints'] = args.joints.split(',')
    elif args.method == 'tip' and 'kind' not in values and values.get('joints'):
        options['joints'] = values['joints']
    return options


def read_joint_limits(file: Path) -> dict[str, dict[str, float]]:
    """Return the limits of a MoveIt joint_limits.yaml, as shape_motion takes them."""
    joints = read_yaml(file).get('joint_limits')
    if not isinstance(joints, dict):
        raise ConfigError(str(file), [f'joint_limits must be a mapping of joints, got {joints!r}'])
    found: dict[str, dict[str, float]] = {}
    findings = []
    for joint, values in joints.items():
        for what in ('velocity', 'acceleration', 'jerk', 'effort'):
            if not isinstance(values, dict) or not values.get(f'has_{what}_limits'):
                continue
            value: Any = values.get(f'max_{what}')
            good = isinstance(value, int | float) and not isinstance(value, bool)
            if not good or not 0.0 < float(value) < float('inf'):
                findings.append(f'{joint}: max_{what} must be a number > 0, got {value!r}')
            else:
                found.setdefault(what, {})[str(joint)] = float(value)
    if findings:
        raise ConfigError(str(file), findings)
    return found


def _robot(args: argparse.Namespace, values: Mapping[str, Any]) -> Robot:
    file = given_file(args.robot, 'robot')
    robot = load_robot(file, gravity=args.gravity or values.get('gravity', EARTH))
    model = values.get('model')
    changes = flatten(model) if isinstance(model, dict) else {}
    changes.update(overrides_of(args.set, args.payload))
    return robot.with_overrides(changes) if changes else robot


def summarize(plan: Plan, times: NDArray[Any]) -> dict[str, Any]:
    """Return the numbers of a plan, ready for JSON."""
    first, last = float(times[0]), float(times[0]) + plan.stretch * float(times[-1] - times[0])
    moving = (plan.t >= first) & (plan.t <= last)
    return {
        'method': plan.method,
        'rows': len(plan.t),
        'begins_s': float(plan.t[0]),
        'ends_s': float(plan.t[-1]),
        'delay_s': plan.delay,
        'stretch': plan.stretch,
        'tip_error_m': float(plan.tip_error[moving].max(initial=0.0)),
        'tip_error_after_m': float(plan.tip_error[~moving].max(initial=0.0)),
        'tip_turn_rad': float(plan.tip_turn.max()),
        'equation_error_m': plan.equation_error,
        'largest_torque': dict(
            zip(plan.joint_names, np.abs(plan.torque).max(axis=0).tolist(), strict=True)
        ),
        **_of_base(plan),
        **_of_limits(plan),
    }


def _of_limits(plan: Plan) -> dict[str, Any]:
    """Return the largest shares of limits, and the gain of 1 % more of each."""
    use = plan.limits
    if use is None:
        return {}
    gains = {name: gain for name, gain in use.gains.items() if gain >= LEAST_GAIN}
    spread = {'limit_spread': dict(use.spread)} if use.spread else {}
    return {'limit_shares': use.largest, 'gains': gains, 'settled': use.settled, **spread}


def _of_base(plan: Plan) -> dict[str, Any]:
    """Return the largest force and torque of thrusters that hold a base."""
    if plan.base_wrench is None:
        return {}
    parts = plan.base_wrench[:, :3], plan.base_wrench[:, 3:]
    force, torque = (float(np.linalg.norm(part, axis=1).max()) for part in parts)
    return {'base_force_N': force, 'base_torque_Nm': torque}


def _page(
    args: argparse.Namespace,
    robot: Robot,
    plan: Plan,
    motion: tuple[NDArray[Any], NDArray[Any]],
    tip: str | list[str] | None,
) -> dict[str, Any]:
    """Write the page; return its part of the summary."""
    if plan.base_wrench is not None:
        robot = held_robot(robot)
    with share_bar(quiet=args.json) as bar:
        found = compare(robot, plan, motion, tip, bar.update)
    made = provenance(
        args.command,
        {
            'robot': named_file(given_file(args.robot, 'robot')),
            'motion': named_file(given_file(args.motion, 'motion')),
        },
    )
    write_text(args.page, page(found, robot.tree, made).html())
    return {'page': str(args.page), **found.summary()}


def _lines(summary: Mapping[str, Any]) -> Iterator[str]:
    yield (
        f'{summary["output"]}: {summary["rows"]} rows from {summary["begins_s"]:.4g} to '
        f'{summary["ends_s"]:.4g} s, method {summary["method"]}'
    )
    if summary.get('gains') or not summary.get('settled', True):
        best = '' if summary['settled'] else ', the best so far'
        yield (
            f'  {summary["stretch"]:.4g} times the time that was asked for, the least within the '
            f'limits{best}'
        )
        for name, gain in sorted(summary['gains'].items(), key=lambda each: -each[1]):
            yield f'  1 % more of {name}: {100.0 * gain:.2f} % less time'
    elif summary['stretch'] > 1.0:
        yield f'  {summary["stretch"]:.4g} times slower, to keep the limits'
    if summary['delay_s'] > 0.0:
        yield f'  {summary["delay_s"]:.4g} s later than asked for'
    for name, share in summary.get('limit_spread', {}).items():
        if share > 1.0:
            yield f'  with other stiffness and load: {share:.3g} times the limit of {name}'
    yield (
        f'  tip off what was asked: {engineering(summary["tip_error_m"], "m")} while moving, '
        f'{engineering(summary["tip_error_after_m"], "m")} before and after'
    )
    for name, value in summary['largest_torque'].items():
        yield f'  largest torque {name}: {value:.4g} N m or N'
    if 'base_force_N' in summary:
        force, torque = summary['base_force_N'], summary['base_torque_Nm']
        yield f'  thrusters hold the base with up to {force:.4g} N and {torque:.4g} N m'
    if 'page' in summary:
        yield f'page    {summary["page"]}'
