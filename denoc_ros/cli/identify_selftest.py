"""`denoc identify selftest`: accuracy of the estimators on newly drawn synthetic decays."""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Callable, Iterable, Iterator
from typing import Any

from denoc_ros.cli.batch import FAILURE, add_worker_options, run_batch, worker_config
from denoc_ros.cli.identify_options import Action
from denoc_ros.cli.verb_result import VerbResult
from denoc_ros.cli.verbs import DOUBTFUL
from denoc_ros.errors import IdentificationError
from denoc_ros.identification.selftest import Job, Outcome, selftest, table
from denoc_ros.reports.text_table import text_table

CHANCE_OF_SHORT = 1e-4  # that a short self-test fails estimators that are just good enough


def _add_selftest(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('--full', action='store_true', help='ten times as many records')
    parser.add_argument(
        '--seed', type=int, help='seed, to repeat a run; default: drawn now, and printed'
    )
    parser.add_argument('--json', action='store_true', help='print machine-readable JSON')
    add_worker_options(parser)


def _selftest(args: argparse.Namespace) -> VerbResult:
    """Measure; exit status 2 when a row of the table is not reached."""
    workers = worker_config(args)

    def runner(measure: Callable[[Job], Outcome], jobs: Iterable[Job]) -> Iterator[Outcome]:
        items = {str(k): (measure, job) for k, job in enumerate(jobs)}
        for row in run_batch(outcome_row, items, None, workers, 'records', not args.json):
            if row[FAILURE]:
                raise IdentificationError(f'selftest: record {row["key"]}: {row[FAILURE]}')
            yield row['outcome']

    seed, outcomes = selftest(args.full, args.seed, runner)
    rows = table(outcomes, 0.0 if args.full else CHANCE_OF_SHORT)
    shown = [
        {
            'condition': row.condition,
            'records': row.records,
            'found': _percent(row.found),
            'within': _percent(row.within),
            'median error': f'{100.0 * row.median:.2g} %',
            'with spurious': row.spurious_records,
            'coverage': _percent(row.coverage),
            'per record': f'{row.seconds:.2g} s',
            'reached': 'yes' if row.passed else 'no',
        }
        for row in rows
    ]
    document = {'seed': seed, 'full': args.full, 'rows': list(map(dataclasses.asdict, rows))}
    status = 0 if all(row.passed for row in rows) else DOUBTFUL
    return VerbResult(document, [f'seed {seed}', text_table(shown)], status)


def outcome_row(item: tuple[Callable[[Job], Outcome], Job]) -> dict[str, Any]:
    """Return one record's outcome as a row, for a worker."""
    measure, job = item
    return {'outcome': measure(job)}


def _percent(part: float) -> str:
    return f'{100.0 * part:.1f} %'


DECLARED = (
    Action(
        'selftest',
        'Draw decays with known modes and the defects of a bag, identify them, and compare the '
        'errors with the required accuracy. Exit status 2 if it is not reached.',
        _add_selftest,
        _selftest,
    ),
)
