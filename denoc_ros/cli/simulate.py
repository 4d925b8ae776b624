"""`denoc simulate ROBOT SCENARIO -o RUN.mcap`: a run without a ROS graph."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from denoc_ros.cli.arguments import given_file
from denoc_ros.cli.batch import add_crew_options
from denoc_ros.errors import BagError, ConfigError

if TYPE_CHECKING:
    from denoc_ros.dynamics.robot import Robot
    from denoc_ros.simulation.run import Run
    from denoc_ros.simulation.scenario import Scenario


def add_parser(subparsers: Any) -> None:
    """Declare the verb's arguments."""
    parser = subparsers.add_parser(
        'simulate',
        help='simulate a robot through a scenario, without a ROS graph',
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
        help='new .mcap file or bag folder; with --vary a folder of Parquet files, added to',
    )
    parser.add_argument(
        '--report', metavar='FILE', type=Path, help='also write the HTML page of the run'
    )
    parser.add_argument('--json', action='store_true', help='print the summary as JSON')
    parser.add_argument(
        '--smooth',
        metavar='HZ',
        type=float,
        help='take motion faster than that out of points of the scenario, such as rounding',
    )
    varied = parser.add_argument_group('many runs, with the model varied')
    varied.add_argument(
        '--vary',
        metavar='PATH=LOW:HIGH',
        action='append',
        default=[],
        help='draw a value of the model evenly (beam.LINK.y.ei=8e4:1.2e5); repeatable',
    )
    varied.add_argument('--runs', metavar='N', type=int, default=100, help='default: 100')
    varied.add_argument('--seed', type=int, default=0, help='of the draws; default: 0')
    add_crew_options(varied)


def run(args: argparse.Namespace) -> int:
    """Run the verb and return the exit status; errors are raised."""
    from tqdm import tqdm

    from denoc_ros.simulation.bag import write_run

    if args.vary:
        from denoc_ros.cli.monte_carlo import run_varied

        if args.report:
            raise ConfigError('--report', ['the page is of one run, got --vary'])
        return run_varied(args)
    if args.output.exists():
        raise BagError(f'{args.output}: output must not exist yet, got an existing one')
    robot, scenario, description = load(args.robot, args.scenario, args.smooth)
    result = scenario.run(robot, progress=not args.json)
    session = session_of(args, robot, scenario, result)
    with tqdm(total=len(result.t), disable=True if args.json else None, leave=False) as bar:
        write_run(result, robot, args.output, description, scenario.reference, bar.update, session)
    summary = {'output': str(args.output), **summarize(robot, result)}
    if args.report:
        from denoc_ros.cli.report import write_report

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
    """Return what a run was, ready for JSON, so that its bag alone tells it."""
    from denoc_ros.reports.provenance import named_file
    from denoc_ros.reports.run_files import SIMULATED
    from denoc_ros.reports.versions import versions

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


def load(robot: str, scenario: str, smooth: float | None = None) -> tuple[Robot, Scenario, str]:
    """Return the robot as the scenario wants it, the scenario, and the robot's URDF text.

    Parameters
    ----------
    robot, scenario : str
        Paths; ones that are not here are looked for where the package is installed.
    smooth : float, optional
        What is faster is taken out of the scenario's points [Hz]; without it, points whose
        accelerations are mostly rounding are warned of.

    Raises
    ------
    ConfigError, ModelError
        With every finding of the file.
    """
    from denoc_ros.cli.config import read_yaml

    robot_file, scenario_file = given_file(robot, 'robot'), given_file(scenario, 'scenario')
    values = _smooth_enough(_with_reference(read_yaml(scenario_file), scenario_file), smooth)
    loaded, made = prepare(robot_file, values, str(scenario_file))
    return loaded, made, robot_file.read_text(encoding='utf-8')


def _with_reference(values: dict[str, Any], scenario: Path) -> dict[str, Any]:
    """Return a scenario with the reference of another file in place of that file's name."""
    from denoc_ros.cli.config import find_file, read_yaml

    name = values.get('reference')
    if not isinstance(name, str):
        return values
    found = find_file(Path(name), scenario.parent)
    if found is None:
        rule = f'reference must be a mapping or an existing YAML file, got {name!r}'
        raise ConfigError(str(scenario), [rule])
    return {**values, 'reference': read_yaml(found)}


def _smooth_enough(values: Mapping[str, Any], smooth: float | None) -> Mapping[str, Any]:
    from denoc_ros.cli.setpoints import rounded_setpoints, smoothed

    if smooth is None:
        for warning in rounded_setpoints(values):
            print(f'denoc simulate: warning: {warning}', file=sys.stderr)
        return values
    if not 0.0 < smooth < float('inf'):
        raise ConfigError('--smooth', [f'the frequency must be > 0 Hz, got {smooth}'])
    return smoothed(values, smooth)


def prepare(
    robot: Path | str,
    values: Mapping[str, Any],
    where: str,
    overrides: Mapping[str, float] | None = None,
) -> tuple[Robot, Scenario]:
    """Return the robot as a scenario wants it, and the scenario.

    Parameters
    ----------
    robot : Path or str
        The URDF file, or its text.
    values : mapping
        The scenario.
    where : str
        The scenario's name in errors.
    overrides : mapping, optional
        Of the model, beside and above those of the scenario.

    Raises
    ------
    ConfigError, ModelError
        With every finding.
    """
    from denoc_ros.dynamics.robot import load_robot
    from denoc_ros.simulation.scenario import model_settings, scenario_from_config

    model = model_settings(values, where)
    loaded = load_robot(
        robot, gravity=model.gravity, geometric_stiffness=model.geometric_stiffness
    )
    if changes := {**model.overrides, **(overrides or {})}:
        loaded = loaded.with_overrides(changes)
    return loaded, scenario_from_config(values, loaded, where)


def summarize(robot: Robot, result: Run) -> dict[str, Any]:
    """Return duration, work done, energy drift and each flexible tip's largest deflection."""
    import numpy as np

    from denoc_ros.dynamics.deflection import TipDeflections

    tips = TipDeflections(robot)
    rows = np.array([tips.evaluate(q, qd)[0] for q, qd in zip(result.q, result.qd, strict=True)])
    largest = {
        name: float(np.max(np.abs(rows[:, column])))
        for column, name in enumerate(tips.names)
        if name.rpartition('/')[2] in ('uy', 'uz', 'rx') and np.any(rows[:, column])
    }
    return {
        'duration_s': float(result.t[-1] - result.t[0]),
        'samples': len(result.t),
        'evaluations': result.evaluations,
        'largest_torque': dict(
            zip(
                robot.joint_names,
                np.max(np.abs(result.torque[:, robot.joint_indices]), axis=0).tolist(),
                strict=True,
            )
        ),
        'largest_deflection': largest,
        'energy_change': result.energy_drift,
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
