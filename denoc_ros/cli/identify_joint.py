"""`denoc identify joint`: friction of a joint from a free swing."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from typing import Any

from denoc_ros.cli.identify_inputs import add_channel_options, add_recording_options, channel_of
from denoc_ros.cli.identify_outputs import give_result
from denoc_ros.cli.verbs import ACTIONS
from denoc_ros.errors import ConfigError, IdentificationError
from denoc_ros.identification.channel import Reading, read_record
from denoc_ros.identification.decrement import critical_joint_damping, log_decrement
from denoc_ros.identification.joint import JointFit, fit_joint
from denoc_ros.identification.quality import assess
from denoc_ros.identification.records import Record
from denoc_ros.identification.result import plain, quality_of, source_of
from denoc_ros.identification.swing_fit import TERMS
from denoc_ros.reports.identify_joint import joint_page
from denoc_ros.reports.pages import ReportPage
from denoc_ros.reports.text_table import text_table
from denoc_ros.reports.versions import versions

Document = dict[str, Any]


def add_actions(actions: Any) -> None:
    """Declare the action's arguments."""
    parser = actions.add_parser(
        'joint',
        help=ACTIONS['joint'],
        description=(
            'Fit viscous, Coulomb and quadratic friction to a free swing at large angle, '
            'report which of them are significant, and give the logarithmic decrement, exact '
            'and as printed in the book.'
        ),
    )
    add_recording_options(parser)
    add_channel_options(parser)
    group = parser.add_argument_group('the joint')
    group.add_argument(
        '--inertia',
        metavar='KG_M2',
        type=float,
        help='inertia about the joint, with motor and gears',
    )
    group.add_argument(
        '--gravity-torque',
        metavar='N_M',
        type=float,
        help='largest gravity torque, m g l: with it the frequency gives the inertia',
    )
    group.add_argument(
        '--spring',
        action='store_true',
        help='the restoring torque is a linear spring, not gravity',
    )
    group.add_argument(
        '--mass-per-length', metavar='KG/M', type=float, help="for the book's coefficient"
    )
    group.add_argument('--length', metavar='M', type=float, help="for the book's coefficient")
    parser.set_defaults(act=run_joint)


def run_joint(args: argparse.Namespace) -> int:
    """Identify; exit status 0 good, 2 doubtful, 3 not identifiable."""
    _check(args)
    reading = read_record(args.path, channel_of(args))
    fit = fit_joint(reading.record, args.inertia, args.gravity_torque, not args.spring)
    document = joint_result(reading, fit, args, versions())

    def page() -> ReportPage:
        return joint_page(document, reading.record, fit, args.command)

    return give_result(args, document, as_text(document), page)


def joint_result(
    reading: Reading, fit: JointFit, args: argparse.Namespace, versions: Mapping[str, str]
) -> Document:
    """Return all that is kept of an identification of a joint."""
    known = args.inertia is not None or args.gravity_torque is not None
    units = dict(zip(TERMS, ('N m s/rad', 'N m', 'N m s^2/rad^2'), strict=True))
    per_inertia = dict(zip(TERMS, ('1/s', '1/s^2', '1/rad'), strict=True))
    document = {
        'kind': 'joint',
        'source': source_of(reading),
        'window': {'begin_s': reading.record.t[0], 'end_s': reading.record.t[-1]},
        'quality': quality_of(assess(reading.record)),
        'method': 'equation of motion integrated, least squares; terms kept by F test',
        'terms': {
            name: {
                'value': getattr(fit, name),
                'interval': fit.interval[name],
                'unit': (units if known else per_inertia)[name],
            }
            for name in fit.terms
        },
        'frequency_hz': fit.frequency,
        'damping_ratio': fit.damping_ratio,
        'inertia_kg_m2': fit.inertia if known else None,
        'residual': fit.residual,
        'models': [
            {'terms': model.terms, 'residual': model.residual, 'rejected': model.rejected}
            for model in fit.models
        ],
        'decrement': [_decrement(reading.record, fit, args, known, c) for c in ('exact', 'book')],
        'verdict': fit.verdict,
        'reasons': fit.reasons,
        'versions': dict(versions),
    }
    return dict(plain(document))


def as_text(document: Mapping[str, Any]) -> str:
    """Return a result's lines for a terminal."""
    source = document['source']
    lines = [
        f'{source["file"]}: {source["topic"]} {source["field"]}'.replace('  ', ' '),
        f'  small swings without friction: {document["frequency_hz"]:.4g} Hz',
    ]
    rows = [
        {'term': name, 'value': one['value'], '95 %': one['interval'], 'unit': one['unit']}
        for name, one in document['terms'].items()
    ]
    lines.append(text_table(rows))
    for model in document['models']:
        said = model['rejected'] or 'chosen'
        lines.append(f'  {" + ".join(model["terms"])}: residual {model["residual"]:.4g}, {said}')
    for one in document['decrement']:
        said = one['reason'] or f'zeta {one["damping_ratio"]:.4g} at {one["frequency_hz"]:.4g} Hz'
        if one['coefficient'] is not None:
            said += f', coefficient {one["coefficient"]:.4g} {one["unit"]}'
        lines.append(f'  log decrement ({one["convention"]}): {said}')
    lines += [f'  {reason}' for reason in document['reasons']]
    return '\n'.join([*lines, f'verdict: {document["verdict"]}'])


def _decrement(
    record: Record, fit: JointFit, args: argparse.Namespace, known: bool, convention: Any
) -> Document:
    row: Document = {
        'convention': convention,
        'damping_ratio': None,
        'frequency_hz': None,
        'critical': None,
        'coefficient': None,
        'unit': 'N m s/rad' if convention == 'exact' else 'kg/s',
        'reason': '',
    }
    try:
        found = log_decrement(record, convention)
    except IdentificationError as error:
        return {**row, 'reason': str(error)}
    row |= {'damping_ratio': found.damping_ratio, 'frequency_hz': found.frequency}
    of_book = args.mass_per_length is not None and args.length is not None
    if known if convention == 'exact' else of_book:
        row['critical'] = critical_joint_damping(
            found.frequency, fit.inertia, args.mass_per_length, args.length, convention
        )
        row['coefficient'] = row['critical'] * found.damping_ratio
    return row


def _check(args: argparse.Namespace) -> None:
    findings = [
        f'{name} must be > 0, got {value}'
        for name, value in (
            ('--inertia', args.inertia),
            ('--gravity-torque', args.gravity_torque),
            ('--mass-per-length', args.mass_per_length),
            ('--length', args.length),
        )
        if value is not None and not 0.0 < value < float('inf')
    ]
    if args.inertia is not None and args.gravity_torque is not None:
        findings.append('--gravity-torque must not come with --inertia, got both')
    ConfigError.raise_any('identify joint', findings)
