"""`denoc stability ROBOT SCENARIO`: the recursion beside dense Cholesky, by three criteria."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np

from denoc_ros.cli.arguments import given_file
from denoc_ros.cli.progress import share_bar
from denoc_ros.cli.simulate import load
from denoc_ros.cli.verbs import DOUBTFUL, VERBS
from denoc_ros.output_files import write_text
from denoc_ros.reports.provenance import named_file, provenance
from denoc_ros.reports.stability import page
from denoc_ros.simulation.scenario import Scenario
from denoc_ros.simulation.stability import Measures, Study, study_stability


def add_parser(subparsers: Any) -> None:
    """Declare the verb's arguments."""
    parser = subparsers.add_parser(
        'stability',
        help=VERBS['stability'],
        description=(
            'Integrate a scenario twice, with forward dynamics by the recursion and by a '
            'Cholesky factor of the inertia matrix, and write one HTML page: deviation, power '
            "difference and roughness of the accelerations (the book's section 7.1), processor"
            ' times, and the growth rate of small errors in the motion itself. Exit status 2: '
            'the recursion leaves the solution before the end.'
        ),
    )
    parser.add_argument('robot', help='the URDF file')
    parser.add_argument(
        'scenario', help='a YAML file with torques, such as config/scenarios/stability_*.yaml'
    )
    parser.add_argument(
        '-o',
        '--output',
        metavar='FILE',
        type=Path,
        default=Path('stability.html'),
        help='file of the page; default: stability.html here',
    )
    parser.add_argument('--json', action='store_true', help='print the numbers as JSON')


def run(args: argparse.Namespace) -> int:
    """Run the verb and return the exit status; errors are raised."""
    robot, scenario, _ = load(args.robot, args.scenario)
    with share_bar(quiet=args.json) as bar:
        study = study_stability(robot, scenario, bar.update)
    summary = summarize(study, scenario)
    names = {'robot': Path(args.robot).name, 'scenario': Path(args.scenario).name}
    given = ((name, given_file(getattr(args, name), name)) for name in names)
    made = provenance(args.command, {name: named_file(file) for name, file in given})
    shown = page(study, scenario, ' · '.join(names.values()), made)
    write_text(args.output, shown.html())
    if args.json:
        named = {'output': str(args.output), **names, **summary}
        print(json.dumps(named, indent=2, allow_nan=False))
    else:
        _print(args.output, summary)
    return 0 if study.acceptable else DOUBTFUL


def summarize(study: Study, scenario: Scenario) -> dict[str, Any]:
    """Return a study's figures, ready for JSON; times in s, deviations in rad or m, powers in W.

    Parameters
    ----------
    study : Study
        As `denoc_ros.simulation.stability.study_stability` returns it.
    scenario : Scenario
        What was studied.
    """
    growing = int(np.argmax(study.growth))
    return {
        'duration_s': float(study.times[-1]),
        'method': scenario.method,
        'tolerance': scenario.rtol,
        'acceptable': study.acceptable,
        'algorithms': {name: _figures(study, one) for name, one in study.runs.items()},
        'largest_power_W': float(np.max(np.abs(study.power))),
        'solution': 'desired motion' if study.exact else 'integrated at 1e-12',
        'solution_roughness': _by_joint(study, study.solution_roughness),
        'difference_of_algorithms': study.difference,
        'difference_at_solution_tolerance': study.fine_difference,
        'largest_growth_per_s': float(study.growth[growing]),
        'largest_growth_at_s': float(study.spectrum_times[growing]),
        'largest_condition_number': float(np.max(study.condition)),
    }


def _figures(study: Study, one: Measures) -> dict[str, Any]:
    trace = one.trace
    figures = {
        'reached_s': float(trace.t[-1]),
        'failure': trace.failure,
        'processor_s': trace.seconds,
        'evaluations': trace.evaluations,
        'forward_dynamics_us': 1e6 * one.call_seconds,
        'acceptable_s': _by_joint(study, one.acceptable),
        'largest_deviation': _by_joint(study, np.max(one.deviation, axis=0)),
        'largest_power_difference_W': float(np.max(np.abs(one.power_difference))),
        'power_acceptable_s': one.power_acceptable,
        'roughness': _by_joint(study, one.roughness),
    }
    if one.from_desired is not None:
        largest = np.max(np.abs(one.from_desired), axis=0)
        figures['largest_difference_from_desired'] = _by_joint(study, largest)
    return figures


def _by_joint(study: Study, values: Any) -> dict[str, float]:
    return {name: float(value) for name, value in zip(study.joint_names, values, strict=True)}


def _print(output: Path, summary: dict[str, Any]) -> None:
    runs = summary['algorithms'].items()
    print(
        f'{output}: {summary["duration_s"]:g} s, {summary["method"]}, '
        f'tolerance {summary["tolerance"]:g}'
    )
    for name, one in runs:
        accepted = min(one['acceptable_s'].values())
        deviation = max(one['largest_deviation'].values())
        print(
            f'  {name}: acceptable to {accepted:.4g} s, largest deviation {deviation:.2g}, power '
            f'difference {one["largest_power_difference_W"]:.2g} of '
            f'{summary["largest_power_W"]:.3g} W, {one["evaluations"]} evaluations, '
            f'{one["processor_s"]:.3g} s of processor, forward dynamics '
            f'{one["forward_dynamics_us"]:.3g} us'
        )
        if one['failure']:
            print(f'    {one["failure"]}')
    print(
        f'  algorithms differ by {summary["difference_of_algorithms"]:.2g}; small errors grow at '
        f'up to {summary["largest_growth_per_s"]:.3g} /s (t = '
        f'{summary["largest_growth_at_s"]:.3g} s); condition number up to '
        f'{summary["largest_condition_number"]:.3g}'
    )
