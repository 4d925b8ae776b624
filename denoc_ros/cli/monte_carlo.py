"""`denoc simulate --vary`: the same scenario many times, with numbers of the model drawn."""

from __future__ import annotations

import argparse
import hashlib
import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from denoc_ros.cli import scenario_runs
from denoc_ros.cli.arguments import given_file, named_values, number_range, require
from denoc_ros.cli.batch import FAILURE, Row, RowStore, WorkerConfig, run_batch, worker_config
from denoc_ros.cli.config import read_yaml
from denoc_ros.cli.scenario_runs import load, prepare
from denoc_ros.dynamics.deflection import TipDeflections
from denoc_ros.errors import ConfigError

Ranges = Mapping[str, tuple[float, float]]
GROUPS = ('largest_torque', 'largest_deflection')
NUMBERS = ('duration_s', 'energy_change')


def run_varied(args: argparse.Namespace) -> int:
    """Run `denoc simulate` with --vary; exit status 1 when no run came to its end."""
    ranges = read_ranges(args.vary)
    if args.runs < 1:
        raise ConfigError('--runs', [f'it must be >= 1, got {args.runs}'])
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
    summary = {'output': str(args.output), **summarize(rows, ranges)}
    print(json.dumps(summary, indent=2) if args.json else '\n'.join(_lines(summary)))
    return 0 if summary['runs'] else 1


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
    robot : str
        URDF text.
    scenario : mapping
        As `denoc_ros.simulation.scenario.scenario_from_config` takes it.
    ranges : mapping
        Dotted path -> lowest and highest value, drawn evenly. A run's draws depend on the seed
        and its number alone, so that more runs can be added to a store.
    runs, seed : int
        How many, and where the draws begin.
    store, workers, progress
        As `denoc_ros.cli.batch.run_batch`.

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
    summary = scenario_runs.summarize(robot, made.run(robot))
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


def read_ranges(settings: Sequence[str]) -> dict[str, tuple[float, float]]:
    """Return PATH=LOW:HIGH as ranges by path; ConfigError with every finding."""
    findings: list[str] = []
    form = 'PATH=LOW:HIGH with LOW <= HIGH'
    ranges = named_values('--vary', settings, form, number_range, findings)
    require(findings)
    return ranges


def summarize(rows: Sequence[Row], ranges: Ranges) -> dict[str, Any]:
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


def _lines(summary: Mapping[str, Any]) -> list[str]:
    failures = summary['failures']
    lines = [f'{summary["output"]}: {summary["runs"]} runs, {len(failures)} failed']
    for name, one in summary['outcomes'].items():
        group, _, whose = name.partition('.')
        lines.append(
            f'  {group.replace("_", " ")} {whose}: {one["mean"]:.4g} ± '
            f'{one["deviation"]:.2g} ({one["lowest"]:.4g} … {one["highest"]:.4g})'
        )
    return lines + [f'  run {one["key"]}: {one["failure"]}' for one in failures[:5]]
