"""`denoc identify forced`: modes from a measured torque and the response to it."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from denoc_ros.cli.identify_inputs import (
    add_channel_options,
    add_recording_options,
    add_verdict_options,
    asked_of,
    channel_of,
)
from denoc_ros.cli.identify_outputs import give_result
from denoc_ros.cli.verbs import ACTIONS
from denoc_ros.identification.channel import Reading, read_record
from denoc_ros.identification.forced import ForcedModes, fit_forced
from denoc_ros.identification.modes import strongest
from denoc_ros.identification.quality import assess
from denoc_ros.identification.records import Record
from denoc_ros.identification.result import plain, quality_of, source_of
from denoc_ros.reports.figures import (
    PHASE_COLOURS,
    RESULT_HEIGHT,
    TRUTH_COLOUR,
    Curve,
    Panel,
    line_figure,
)
from denoc_ros.reports.identify_result import mode_cards, modes_found, result_page, verdict_text
from denoc_ros.reports.pages import PageSection, ReportPage
from denoc_ros.reports.text_table import text_table
from denoc_ros.reports.versions import versions

Document = dict[str, Any]


def add_actions(actions: Any) -> None:
    """Declare the action's arguments."""
    parser = actions.add_parser(
        'forced',
        help=ACTIONS['forced'],
        description='Fit a rational frequency response to a measured input (torque, by --force-*) '
        'and its response (--topic, --field). A table without times takes --rate; with --rate 1 '
        'frequencies are in cycles per sample.',
    )
    add_recording_options(parser)
    group = parser.add_argument_group('the input')
    group.add_argument(
        '--force-topic', default='', help='topic of the input; default: that of the response'
    )
    group.add_argument(
        '--force-field',
        required=True,
        action='append',
        help='field of the input, as --field; repeat it for inputs that act together',
    )
    group.add_argument(
        '--force-quantity',
        choices=('position', 'velocity', 'effort'),
        default='effort',
        help='quantity of a JointState; default: effort',
    )
    add_channel_options(parser)
    add_verdict_options(parser)
    parser.set_defaults(act=run_forced)


def run_forced(args: argparse.Namespace) -> int:
    """Identify; exit status 0 good, 2 doubtful, 3 not identifiable."""
    channel, (band, count) = channel_of(args), asked_of(args)
    response = read_record(args.path, channel)
    sources = [
        replace(
            channel,
            topic=args.force_topic or response.channel.topic,
            field=field,
            quantity=args.force_quantity,
            gain=1.0,
            offset=0.0,
            unit='',
        )
        for field in args.force_field
    ]
    forces, answer = _together([read_record(args.path, one) for one in sources], response)
    found = fit_forced(forces, answer)
    asked = strongest(found.frequency, found.strength, band, count)
    names = ', '.join(one.name for one in sources)
    document = forced_result(response, names, answer, found, versions(), asked)
    return give_result(
        args,
        document,
        as_text(document),
        lambda: forced_page(document, answer, found, args.command),
    )


def forced_result(
    reading: Reading,
    force: str,
    record: Record,
    found: ForcedModes,
    versions: Mapping[str, str],
    asked: Sequence[int],
) -> Document:
    """Return all that is kept of an identification from torque and response."""
    modes = [
        {
            'frequency_hz': found.frequency[k],
            'damping_ratio': found.damping_ratio[k],
            'interval': found.interval[k],
            'formal_interval': found.formal_interval[k],
            'window_interval': found.window_interval[k],
            'strength': found.strength[k],
            'asked': k in asked,
            'verdict': found.verdict[k],
            'reasons': found.reasons[k],
        }
        for k in range(len(found.frequency))
    ]
    document = {
        'kind': 'forced',
        'source': {**source_of(reading), 'force': force},
        'window': {'begin_s': record.t[0], 'end_s': record.t[-1]},
        'quality': quality_of(assess(record)),
        'method': 'rational frequency response at the excited lines, least squares; order by BIC',
        'modes': modes,
        'explained': found.explained,
        'verdict': found.status_of(asked),
        'remarks': found.remarks,
        'reasons': [*found.remarks, *(one for k in asked for one in found.reasons[k])],
        'versions': dict(versions),
    }
    return dict(plain(document))


def as_text(document: Mapping[str, Any]) -> str:
    """Return a result's lines for a terminal."""
    source = document['source']
    lines = [
        f'{source["file"]}: {source["field"]} from {source["force"]}, '
        f'{100.0 * document["explained"]:.1f} % explained'
    ]
    rows = [
        {
            'f [Hz]': mode['frequency_hz'],
            'zeta': mode['damping_ratio'],
            '95 %': mode['interval'],
            'strength': mode['strength'],
            'verdict': mode['verdict'],
        }
        for mode in document['modes']
    ]
    if rows:
        lines.append(text_table(rows))
    for mode in document['modes']:
        lines += [f'  {mode["frequency_hz"]:.4g} Hz: {reason}' for reason in mode['reasons']]
    lines += [f'  {remark}' for remark in document['remarks']]
    return '\n'.join([*lines, verdict_text(document)])


def forced_page(
    document: Mapping[str, Any], record: Record, found: ForcedModes, command: str
) -> ReportPage:
    """Return the page of modes from torque and response."""
    explained = f'{100.0 * document["explained"]:.1f} % of the response explained'
    return result_page(
        document,
        f'Forced response of {record.name}',
        f'{modes_found(document)}; {explained}',
        mode_cards(document),
        [_response(found)],
        command,
    )


def _response(found: ForcedModes) -> PageSection:
    inputs = found.measured.shape[1]
    panels = [
        Panel(
            title + (f', input {k + 1}' if inputs > 1 else ''),
            unit,
            [
                Curve('measured', TRUTH_COLOUR, found.line, of(found.measured[:, k]), marker='.'),
                Curve('fitted', PHASE_COLOURS[0], found.line, of(found.fitted[:, k])),
            ],
            x_label='frequency [Hz]',
            log_y=log,
        )
        for k in range(inputs)
        for title, unit, of, log in (
            ('response over input, magnitude', '', np.abs, True),
            ('phase', 'rad', np.angle, False),
        )
    ]
    return PageSection(
        'Frequency response',
        'Ratio of the transforms at the lines that the input excites, and the fitted modes.',
        [line_figure(panels, RESULT_HEIGHT)],
    )


def _together(forces: Sequence[Reading], response: Reading) -> tuple[list[Record], Record]:
    """Return inputs and response on the stamps of the response where all are there."""
    answer = response.record
    shifted = [
        (one.record, one.record.t + (one.origin_ns - response.origin_ns) * 1e-9) for one in forces
    ]
    if not all(np.array_equal(t, answer.t) for _, t in shifted):
        start = max(answer.t[0], *(t[0] for _, t in shifted))
        answer = answer.part(start, min(answer.t[-1], *(t[-1] for _, t in shifted)))
    return [
        Record(answer.t, np.interp(answer.t, t, one.y), one.name, one.unit) for one, t in shifted
    ], answer
