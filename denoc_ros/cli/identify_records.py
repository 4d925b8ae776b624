"""`denoc identify info` and `segment`: the signals and segments of a recording."""

from __future__ import annotations

import argparse
import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

from denoc_ros.cli.exit_statuses import NOT_IDENTIFIABLE
from denoc_ros.cli.identify_inputs import add_channel_options, channel_of
from denoc_ros.cli.verbs import ACTIONS
from denoc_ros.errors import BagError, DenocError
from denoc_ros.identification.channel import Channel, channels_of, read_record
from denoc_ros.identification.quality import assess
from denoc_ros.identification.segments import find_segments
from denoc_ros.reports.text_table import Row, text_table


def add_actions(actions: Any) -> None:
    """Declare both actions' arguments."""
    info = actions.add_parser(
        'info',
        help=ACTIONS['info'],
        description=(
            'List the signals of a bag or a table: rate, gaps, jitter, clipping, resolution, '
            'noise. --topic and --field select some of them.'
        ),
    )
    info.add_argument('path', metavar='BAG', type=Path, help='a bag or a table')
    add_channel_options(info)
    info.add_argument('--json', action='store_true', help='print machine-readable JSON')
    info.set_defaults(act=run_info)
    segment = actions.add_parser(
        'segment',
        help=ACTIONS['segment'],
        description='List the segments of a signal: free decays, steps, rests.',
    )
    segment.add_argument('path', metavar='BAG', type=Path, help='a bag or a table')
    add_channel_options(segment)
    segment.add_argument('--json', action='store_true', help='print machine-readable JSON')
    segment.set_defaults(act=run_segment)


def run_info(args: argparse.Namespace) -> int:
    """List the signals; an error when none of them makes a record."""
    rows = describe(args.path, channel_of(args))
    if all('problem' in row for row in rows):
        raise BagError('\n'.join(dict.fromkeys(row['problem'] for row in rows)))
    if args.json:
        print(json.dumps({'file': str(args.path), 'signals': rows}, indent=2))
    else:
        print(f'{args.path}: {len(rows)} signals')
        print(text_table([row for row in rows if 'problem' not in row]))
        for row in rows:
            if 'problem' in row:
                print(f'  {row["signal"]}: {row["problem"]}')
    return 0


def run_segment(args: argparse.Namespace) -> int:
    """List the segments; exit status 3 when there is no free decay."""
    reading = read_record(args.path, channel_of(args))
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
        for segment in find_segments(reading.record)
    ]
    if args.json:
        print(json.dumps({'signal': reading.record.name, 'segments': rows}, indent=2))
    else:
        print(f'{reading.record.name}: {len(rows)} segments')
        if rows:
            print(text_table(rows))
    return 0 if any(row['kind'] == 'decay' for row in rows) else NOT_IDENTIFIABLE


def describe(path: Path, channel: Channel) -> list[Row]:
    """Return one row of quality per signal that the channel leaves open.

    Parameters
    ----------
    path : Path
        A bag or a table.
    channel : Channel
        What it names is all that is described.

    Raises
    ------
    BagError
        When the file cannot be read, or has no such signal.
    """
    chosen = [channel]
    if not channel.field:
        chosen = [
            replace(channel, topic=one.topic, field=one.field, quantity=one.quantity)
            for one in channels_of(path)
            if channel.topic in ('', one.topic)
        ]
    return [_row(path, one) for one in chosen]


def _row(path: Path, channel: Channel) -> Row:
    try:
        reading = read_record(path, channel)
    except DenocError as error:
        return {'signal': channel.name, 'problem': str(error)}
    quality = assess(reading.record)
    return {
        'signal': reading.channel.name,
        'samples': quality.samples,
        'duration_s': quality.duration,
        'rate_hz': quality.rate,
        'gaps': quality.gaps,
        'longest_gap_s': quality.longest_gap,
        'lost': quality.lost,
        'jitter': quality.jitter,
        'clipped': int(quality.clipped.sum()),
        'resolution': quality.resolution,
        'noise': quality.noise,
        'snr_db': quality.snr_db if math.isfinite(quality.snr_db) else None,
    }
