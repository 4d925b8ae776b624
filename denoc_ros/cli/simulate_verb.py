"""`denoc simulate ROBOT SCENARIO -o RUN.mcap`: a run without a ROS graph."""

from __future__ import annotations

import argparse
import hashlib
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from denoc_ros.cli.arguments import (
    add_json,
    add_number,
    add_option,
    add_output,
    add_pairs,
    given_file,
    number_range,
)
from denoc_ros.cli.many_runs import (
    FAILURE,
    RowStore,
    WorkerConfig,
    add_worker_options,
    run_batch,
    worker_config,
)
from denoc_ros.cli.session.session_config import read_reference, read_yaml
from denoc_ros.cli.verb_result import VerbResult
from denoc_ros.cli.verbs import BAD_INPUT
from denoc_ros.dynamics.elastic.deflection import TipDeflections
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import ConfigError
from denoc_ros.estimation.setpoints import rounded_setpoints, smoothed
from denoc_ros.model.reading.source import complete_text
from denoc_ros.output_files import require_new
from denoc_ros.pages.provenance import named_file, versions
from denoc_ros.parts import required
from denoc_ros.simulation.recorded.run_files import SIMULATED
from denoc_ros.simulation.scenario import Scenario, model_settings, scenario_from_config
from denoc_ros.simulation.simulate import Run
from denoc_ros.simulation.simulated_bag import write_run
from denoc_ros.terminal_text import say
from denoc_ros.text_table import Row

Ranges = Mapping[str, tuple[float, float]]
GROUPS = ('largest_torque', 'largest_deflection')
NUMBERS = ('duration_s', 'energy_change')
DESCRIPTION = (
    'Integrate the equations of motion through a scenario and write the run as MCAP: '
    'joint_states, plant/true_modal_state and plant/true_deflection.'
)


def load(robot: str, scenario: str, smooth: float | None = None) -> tuple[Robot, Scenario, str]:
    """Return the robot as the scenario wants it, the scenario, and the robot's URDF text.

    Parameters
    ----------
    robot, scenario : str
        Paths; ones that are not here are looked for where the package is installed.
    smooth : float, optional
        What is faster is taken out of the scenario's points [Hz]; without it, points whose
        accelerations are mostly rounding are warned of.
    """
    robot_file, scenario_file = given_file(robot, 'robot'), given_file(scenario, 'scenario')
    values = read_yaml(scenario_file)
    if isinstance(name := values.get('reference'), str):
        values['reference'] = read_reference(name, scenario_file.parent, str(scenario_file))
    loaded, made = prepare(robot_file, _smooth_enough(values, smooth), str(scenario_file))
    return loaded, made, complete_text(robot_file)


def _smooth_enough(values: Mapping[str, Any], smooth: float | None) -> Mapping[str, Any]:
    if smooth is None:
        for warning in rounded_setpoints(values):
            say(f'denoc simulate: warning: {warning}', file=sys.stderr)
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
    overrides : mapping, optional
        Of the model, beside and above those of the scenario.
    """
    loaded = model_settings(values, where).load(robot, overrides)
    return loaded, scenario_from_config(values, loaded, where)


def summarize(robot: Robot, result: Run) -> dict[str, Any]:
    """Return duration, work done, energy drift and each flexible tip's largest deflection."""
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


def run_varied(args: argparse.Namespace) -> VerbResult:
    """Run `denoc simulate` with --vary; exit status 1 when no run came to its end."""
    ranges = args.vary
    robot, _, text = load(args.robot, args.scenario)
    for corner in (0, 1):
        robot.with_overrides({path: ends[corner] for path, ends in ranges.items()})
    rows = vary(
        text,
        read_yaml(given_file(args.scenario, 'scenario')),
        ranges,
        args.runs,
        args.seed,
        RowStore(args.output, columns_of(robot, ranges)),
        worker_config(args),
        progress=not args.json,
    )
    summary = {'output': str(args.output), **summarize_rows(rows, ranges)}
    return VerbResult(summary, _lines_of_many(summary), 0 if summary['runs'] else BAD_INPUT)


def vary(
    robot: str,
    scenario: Mapping[str, Any],
    ranges: Ranges,
    runs: int,
    seed: int,
    store: RowStore | None = None,
    workers: WorkerConfig | None = None,
    progress: bool = False,
) -> list[Row]:
    """Simulate a scenario with drawn numbers of the model and return one row per run.

    Parameters
    ----------
    scenario : mapping
        As `denoc_ros.simulation.scenario.scenario_from_config` takes it.
    ranges : mapping
        Dotted path -> lowest and highest value, drawn evenly. A run's draws depend on the seed
        and its number alone, so that more runs can be added to a store.

    Returns
    -------
    list of dict
        The drawn values by path, `duration_s`, `energy_change`, `largest_torque.JOINT` [N m, N]
        and `largest_deflection.LINK/uy` [m, rad]; or `failure`.
    """
    # rows of another robot, scenario or range must not pass for these
    asked = hashlib.sha256(repr((robot, scenario, ranges)).encode()).hexdigest()[:12]
    items = {
        f'{asked}/{seed}/{run}': (robot, dict(scenario), draw(ranges, seed, run))
        for run in range(runs)
    }
    return run_batch(simulate_row, items, store, workers or WorkerConfig(), 'runs', progress)


def draw(ranges: Ranges, seed: int, run: int) -> dict[str, float]:
    """Return the values of one run by path."""
    shares = np.random.default_rng([seed, run]).uniform(size=len(ranges))
    return {
        path: float(low + share * (high - low))
        for share, (path, (low, high)) in zip(shares, ranges.items(), strict=True)
    }


def simulate_row(item: tuple[str, Mapping[str, Any], Mapping[str, float]]) -> Row:
    """Simulate once and return the drawn values and the results."""
    text, scenario, drawn = item
    robot, made = prepare(text, scenario, 'scenario', drawn)
    summary = summarize(robot, made.run(robot))
    row: Row = {**drawn, **{name: summary[name] for name in NUMBERS}}
    for group in GROUPS:
        row |= {f'{group}.{name}': value for name, value in summary[group].items()}
    return row


def columns_of(robot: Any, ranges: Ranges) -> dict[str, type]:
    """Return the columns of a run's row."""
    tips = [n for n in TipDeflections(robot).names if n.rpartition('/')[2] in ('uy', 'uz', 'rx')]
    names = [*ranges, *NUMBERS]
    for group, whose in zip(GROUPS, (robot.joint_names, tips), strict=True):
        names += [f'{group}.{name}' for name in whose]
    return dict.fromkeys(names, float)


def summarize_rows(rows: Sequence[Row], ranges: Ranges) -> dict[str, Any]:
    """Return how many runs ended well, and of each of their numbers the mean and spread."""
    good = [row for row in rows if not row[FAILURE]]
    names = dict.fromkeys(name for row in good for name in row if name not in ranges)
    outcomes = {}
    for name in names:
        values = [row[name] for row in good if isinstance(row.get(name), float)]
        if values and '.' in name:
            outcomes[name] = {
                'mean': float(np.mean(values)),
                'deviation': float(np.std(values)),
                'lowest': min(values),
                'highest': max(values),
            }
    failures = [{'key': row['key'], 'failure': row[FAILURE]} for row in rows if row[FAILURE]]
    return {'runs': len(good), 'outcomes': outcomes, 'failures': failures}


def _lines_of_many(summary: Mapping[str, Any]) -> list[str]:
    failures = summary['failures']
    lines = [f'{summary["output"]}: {summary["runs"]} runs, {len(failures)} failed']
    for name, one in summary['outcomes'].items():
        group, _, whose = name.partition('.')
        lines.append(
            f'  {group.replace("_", " ")} {whose}: {one["mean"]:.4g} ± '
            f'{one["deviation"]:.2g} ({one["lowest"]:.4g} … {one["highest"]:.4g})'
        )
    return lines + [f'  run {one["key"]}: {one["failure"]}' for one in failures[:5]]


def add_options(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    add_option(parser, 'robot', 'the URDF file')
    add_option(parser, 'scenario', 'a YAML file, such as config/scenarios/*.yaml')
    add_output(
        parser,
        '',
        'new .mcap file or bag folder; with --vary a folder of Parquet files, which grow',
        required=True,
    )
    add_option(parser, '--report FILE', 'also write the HTML page of the run', type=Path)
    add_json(parser)
    add_option(
        parser,
        '--smooth HZ',
        'remove faster motion, such as rounding errors, from the points of the scenario',
        type=float,
    )
    varied = parser.add_argument_group('many runs, with the model varied')
    add_pairs(
        varied,
        '--vary PATH=LOW:HIGH',
        'draw a value of the model from a uniform distribution (beam.LINK.y.ei=8e4:1.2e5)',
        number_range,
        form='PATH=LOW:HIGH with LOW <= HIGH',
    )
    add_number(varied, '--runs N', 100, 'number of runs', '', 1)
    add_option(varied, '--seed', 'seed of the draws; default: 0', 0)
    add_worker_options(varied)


def run(args: argparse.Namespace) -> VerbResult:
    """Simulate, once or with the model varied; errors are raised."""
    if args.vary:
        if args.report:
            raise ConfigError('--report', ['the page is of one run, got --vary'])
        return run_varied(args)
    require_new(args.output)
    robot, scenario, description = load(args.robot, args.scenario, args.smooth)
    result = scenario.run(robot, progress=not args.json)
    session = session_of(args, robot, scenario, result)
    with tqdm(total=len(result.t), disable=True if args.json else None, leave=False) as bar:
        asked, moves = scenario.reference, scenario.base is not None
        write_run(result, robot, args.output, description, asked, bar.update, session, moves)
    summary = {'output': str(args.output), **summarize(robot, result)}
    if args.report:
        reports = required('reports.report_verb', '--report')
        reports.write_report(args.output, args.report, args.command)
        summary['report'] = str(args.report)
    return VerbResult(summary, _lines(summary))


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


def _lines(summary: Mapping[str, Any]) -> Iterator[str]:
    show: Callable[[float], str] = '{:.4g}'.format
    yield (
        f'{summary["output"]}: {show(summary["duration_s"])} s, {summary["samples"]} samples, '
        f'{summary["evaluations"]} evaluations'
    )
    change = show(summary['energy_change'])
    yield f'  total energy: largest change {change} of the largest kinetic energy'
    for title, unit in (('largest_torque', 'N m or N'), ('largest_deflection', 'm or rad')):
        for name, value in summary[title].items():
            yield f'  {title.replace("_", " ")} {name}: {show(value)} {unit}'
    if 'report' in summary:
        yield f'report  {summary["report"]}'
