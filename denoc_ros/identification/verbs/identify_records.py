"""`denoc identify`: info, segment, modal, forced, servo: signals of a recording."""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path

from denoc_ros.bags.reader import bag_folder
from denoc_ros.cli.arguments import (
    WINDOW,
    add_json,
    add_option,
    add_output,
    add_pairs,
    add_row,
    add_settings,
    given_file,
    require,
    settings_of,
    window_findings,
)
from denoc_ros.cli.many_runs import WorkerConfig, add_worker_options, worker_config
from denoc_ros.cli.verb_result import VerbResult
from denoc_ros.cli.verbs import NOT_IDENTIFIABLE
from denoc_ros.errors import BagError
from denoc_ros.identification.decay.channel import Channel, read_record
from denoc_ros.identification.decay.forced import identify_forced
from denoc_ros.identification.decay.record_segments import find_segments
from denoc_ros.identification.identification_result import (
    TABLE_COLUMNS,
    DecayOptions,
    describe,
    flat_mode,
    identify_decay,
)
from denoc_ros.identification.pages.identify_signals import (
    decay_page,
    decay_text,
    forced_page,
    forced_text,
    servo_page,
    servo_text,
)
from denoc_ros.identification.servo.servo_runs import ServoOptions, identify_servos
from denoc_ros.identification.verbs.identify_options import (
    Action,
    Asked,
    Fit,
    add_channel_options,
    add_recording_options,
    add_robot_options,
    add_verdict_options,
    asked_of,
    channel_of,
)
from denoc_ros.identification.verbs.identify_rows import RowKind, recordings, rows_result
from denoc_ros.output_files import Document
from denoc_ros.settings import declared
from denoc_ros.terminal_text import say
from denoc_ros.text_table import Row, text_table


def _add_signal(parser: argparse.ArgumentParser) -> None:
    add_option(parser, 'path BAG', 'a bag or a table', type=Path)
    add_channel_options(parser)
    add_json(parser)


def _info(path: Path, channel: Channel) -> VerbResult:
    """List the signals; an error when none of them makes a record."""
    rows = describe(path, channel)
    good = [row for row in rows if 'problem' not in row]
    bad = [row for row in rows if 'problem' in row]
    if not good:
        raise BagError('\n'.join(dict.fromkeys(row['problem'] for row in bad)))
    lines = [
        f'{path}: {len(rows)} signals',
        text_table(good),
        *(f'  {row["signal"]}: {row["problem"]}' for row in bad),
    ]
    return VerbResult({'file': str(path), 'signals': rows}, lines)


def _segment(path: Path, channel: Channel) -> VerbResult:
    """List the segments; exit status 3 when there is no free decay."""
    record = read_record(path, channel).record
    rows = [
        {
            'kind': segment.kind,
            'begin_s': float(segment.start),
            'end_s': float(segment.stop),
            'duration_s': float(segment.stop - segment.start),
            'amplitude': float(segment.amplitude),
            'level': float(segment.level),
            'frequency_hz': float(segment.frequency) or None,
        }
        for segment in find_segments(record)
    ]
    lines = [f'{record.name}: {len(rows)} segments', *([text_table(rows)] if rows else [])]
    status = 0 if any(row['kind'] == 'decay' for row in rows) else NOT_IDENTIFIABLE
    return VerbResult({'signal': record.name, 'segments': rows}, lines, status)


def _add_modal(parser: argparse.ArgumentParser) -> None:
    add_option(parser, 'paths BAG', "bags, tables, folders, or 'bags/**/*.mcap'", nargs='+')
    add_output(
        parser,
        'FOLDER',
        'folder for result.yaml, modes.csv and report.html of one recording, or for Parquet '
        'files of several, which grow',
    )
    add_json(parser)
    add_channel_options(parser)
    add_verdict_options(parser)
    add_robot_options(parser)
    add_worker_options(parser)


def decay_options(args: argparse.Namespace) -> DecayOptions:
    """Return the options of `denoc identify modal`; ConfigError with findings."""
    channel, (band, count) = channel_of(args), asked_of(args)
    return DecayOptions(
        channel=channel,
        band=band,
        count=count,
        robot=args.robot,
        file=given_file(args.robot, 'robot').resolve() if args.robot else None,
        joints=args.at,
        held=args.joints == 'held',
        gravity=tuple(args.gravity),
    )


def _modal(
    paths: list[str], output: Path | None, workers: WorkerConfig, json: bool, options: DecayOptions
) -> Fit | VerbResult:
    """Identify; exit status of the modes asked for: 0 good, 2 doubtful, 3 not identifiable."""
    found = recordings(paths)
    is_one = len(paths) == 1 and bag_folder(Path(paths[0])) == found[0]
    if not is_one or workers != WorkerConfig():
        return rows_result(MODAL, options, found, output, workers, not json)
    document, analysis = identify_decay(found[0], options)
    return Fit(document, (analysis,), _left_out(options, document))


def _left_out(options: DecayOptions, document: Document) -> list[str]:
    """Return the warning that a named robot does not have the modes."""
    note = document.get('model', {}).get('left_out')
    return [f'denoc identify: coefficients left out: {note}'] if note and options.robot else []


def modal_row(item: tuple[DecayOptions, Path]) -> Row:
    """Return one recording's row."""
    options, path = item
    document, _ = identify_decay(path, options)
    for note in _left_out(options, document):
        say(note, file=sys.stderr)
    modes = [flat_mode(mode) for mode in document['modes']]
    return {
        'verdict': document['verdict'],
        'modes': len(modes),
        **{name: [mode[name] for mode in modes] for name in OF_MODES},
        'begin_s': document['window']['begin_s'],
        'end_s': document['window']['end_s'],
        'reasons': '; '.join(document['reasons']),
    }


def _shown(row: Row) -> Row:
    return {
        'f [Hz]': ' '.join(f'{value:.4g}' for value in row['frequency_hz']) or '-',
        'zeta': ' '.join(f'{value:.4g}' for value in row['damping_ratio']) or '-',
    }


OF_MODES = TABLE_COLUMNS[:-1]  # all but the verdict
MODAL = RowKind(
    modal_row,
    {'modes': int, **dict.fromkeys(OF_MODES, list), 'begin_s': float, 'end_s': float},
    _shown,
)


def _add_forced(parser: argparse.ArgumentParser) -> None:
    add_recording_options(parser)
    group = parser.add_argument_group('the input')
    add_option(group, '--force-topic', 'topic of the input; default: that of the response', '')
    add_option(
        group,
        '--force-field',
        'field of the input, as --field; repeat it for inputs that act together',
        required=True,
        action='append',
    )
    add_option(
        group,
        '--force-quantity',
        'quantity of a JointState; default: effort',
        'effort',
        choices=('position', 'velocity', 'effort'),
    )
    add_channel_options(parser)
    add_verdict_options(parser)


def _inputs(args: argparse.Namespace) -> list[Channel]:
    force = replace(
        channel_of(args),
        topic=args.force_topic,
        quantity=args.force_quantity,
        gain=1.0,
        offset=0.0,
        unit='',
    )
    return [replace(force, field=field) for field in args.force_field]


def _forced(path: Path, channel: Channel, inputs: list[Channel], asked: Asked) -> Fit:
    document, *drawn = identify_forced(path, channel, inputs, *asked)
    return Fit(document, tuple(drawn))


def _add_servo(parser: argparse.ArgumentParser) -> None:
    add_recording_options(parser, several=True)
    group = parser.add_argument_group('the signals')
    row = declared(ServoOptions)['commanded']
    add_row(group, '--command TOPIC', row, row.default, dest='commanded')
    add_option(
        group,
        '--topic',
        'topic of the measured JointState; default: /joint_states',
        '/joint_states',
    )
    add_pairs(
        group,
        '--column JOINT.FIELD=COLUMN',
        'column of a table with what a joint is told (FIELD command) or its position; '
        'default: columns such as elbow/command and elbow/position',
    )
    add_option(
        group,
        '--joint NAME',
        'joint to identify; repeatable; default: all commanded joints',
        action='append',
    )
    add_settings(group, Channel, *WINDOW)


def _servo_options(args: argparse.Namespace) -> ServoOptions:
    require(window_findings(args))
    return ServoOptions(settings_of(Channel, args), args.commanded, args.column, args.joint or ())


def _servo(path: list[Path], options: ServoOptions) -> Fit:
    document, found = identify_servos(path, options)
    return Fit(document, (found,))


DECLARED = (
    Action(
        'info',
        'List the signals of a bag or a table: rate, gaps, jitter, clipping, resolution, noise. '
        '--topic and --field select some of them.',
        _add_signal,
        _info,
    ),
    Action(
        'segment',
        'List the segments of a signal: free decays, steps, rests.',
        _add_signal,
        _segment,
    ),
    Action(
        'modal',
        'Identify the modes of a free decay and their number. Several recordings, a folder or a '
        'quoted pattern give one row each.',
        _add_modal,
        _modal,
        decay_text,
        decay_page,
        {'options': decay_options, 'workers': worker_config},
    ),
    Action(
        'forced',
        'Fit a rational frequency response to a measured input (torque, by --force-*) and its '
        'response (--topic, --field). A table without times takes --rate; with --rate 1 '
        'frequencies are in cycles per sample.',
        _add_forced,
        _forced,
        forced_text,
        forced_page,
        {'inputs': _inputs},
    ),
    Action(
        'servo',
        'Fit a second-order lag with a delay and a static gain to the commanded and the measured '
        'positions of joints; several recordings are fitted together. The result is the '
        "shaper's `servo.*`.",
        _add_servo,
        _servo,
        servo_text,
        servo_page,
        {'options': _servo_options},
    ),
)
