"""`denoc simulate ROBOT SCENARIO -o RUN.mcap`: a run without a ROS graph."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tqdm import tqdm

from denoc_ros.cli.arguments import given_file
from denoc_ros.cli.batch import add_worker_options
from denoc_ros.cli.monte_carlo import run_varied
from denoc_ros.cli.report import write_report
from denoc_ros.cli.scenario_runs import load, summarize
from denoc_ros.cli.verbs import VERBS
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import ConfigError
from denoc_ros.output_files import require_new
from denoc_ros.reports.provenance import named_file
from denoc_ros.reports.run_files import SIMULATED
from denoc_ros.reports.versions import versions
from denoc_ros.simulation.bag import write_run
from denoc_ros.simulation.scenario import Scenario
from denoc_ros.simulation.simulate import Run


def add_parser(subparsers: Any) -> None:
    """Declare the verb's arguments."""
    parser = subparsers.add_parser(
        'simulate',
        help=VERBS['simulate'],
        description='Integrate the equations of motion through a scenario and write the run as '
        'MCAP: joint_states, plant/true_modal_state and plant/true_deflection.',
    )
    parser.add_argument('robot', help='the URDF file')
    parser.add_argument('scenario', help='a YAML file, such as config/scenarios/*.yaml')
    parser.add_argument(
        '-o',
        '--output',
        type=Path,
        required=True,
        help='new .mcap file or bag folder; with --vary a folder of Parquet files, which grow',
    )
    parser.add_argument(
        '--report', metavar='FILE', type=Path, help='also write the HTML page of the run'
    )
    parser.add_argument('--json', action='store_true', help='print the summary as JSON')
    parser.add_argument(
        '--smooth',
        metavar='HZ',
        type=float,
        help='remove faster motion, such as rounding errors, from the points of the scenario',
    )
    varied = parser.add_argument_group('many runs, with the model varied')
    varied.add_argument(
        '--vary',
        metavar='PATH=LOW:HIGH',
        action='append',
        default=[],
        help=(
            'draw a value of the model from a uniform distribution (beam.LINK.y.ei=8e4:1.2e5);'
            ' repeatable'
        ),
    )
    varied.add_argument(
        '--runs', metavar='N', type=int, default=100, help='number of runs; default: 100'
    )
    varied.add_argument('--seed', type=int, default=0, help='seed of the draws; default: 0')
    add_worker_options(varied)


def run(args: argparse.Namespace) -> int:
    """Run the verb and return the exit status; errors are raised."""
    if args.vary:
        if args.report:
            raise ConfigError('--report', ['the page is of one run, got --vary'])
        return run_varied(args)
    require_new(args.output)
    robot, scenario, description = load(args.robot, args.scenario, args.smooth)
    result = scenario.run(robot, progress=not args.json)
    session = session_of(args, robot, scenario, result)
    with tqdm(total=len(result.t), disable=True if args.json else None, leave=False) as bar:
        write_run(result, robot, args.output, description, scenario.reference, bar.update, session)
    summary = {'output': str(args.output), **summarize(robot, result)}
    if args.report:
        write_report(args.output, args.report, args.command)
        summary['report'] = str(args.report)
    if args.json:
        print(json.dumps(summary, indent=2))
    else:
        _print(args.output, summary)
    return 0


def session_of(
    args: argparse.Namespace, robot: Robot, scenario: Scenario, result: Run
) -> dict[str, Any]:
    """Return the settings of a run, ready for JSON, so that its bag is self-contained."""
    return {
        'kind': SIMULATED,
        'name': Path(args.scenario).stem,
        'robot': Path(args.robot).name,
        'scenario': named_file(given_file(args.scenario, 'scenario')),
        'gravity': robot.gravity.tolist(),
        'geometric_stiffness': robot.geometric_stiffness,
        'model': dict(robot.tree.overrides),
        'method': scenario.method,
        'rtol': scenario.rtol,
        'evaluations': result.evaluations,
        'command': args.command,
        'versions': versions(),
    }


def _print(output: Path, summary: dict[str, Any]) -> None:
    show: Callable[[float], str] = '{:.4g}'.format
    print(
        f'{output}: {show(summary["duration_s"])} s, {summary["samples"]} samples, '
        f'{summary["evaluations"]} evaluations'
    )
    change = show(summary['energy_change'])
    print(f'  total energy: largest change {change} of the largest kinetic energy')
    for title, unit in (('largest_torque', 'N m or N'), ('largest_deflection', 'm or rad')):
        for name, value in summary[title].items():
            print(f'  {title.replace("_", " ")} {name}: {show(value)} {unit}')
    if 'report' in summary:
        print(f'report  {summary["report"]}')
