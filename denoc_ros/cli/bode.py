"""`denoc check ROBOT --bode IN:OUT`: would a loop ring; a page of frequency responses."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from denoc_ros.cli.arguments import given_file
from denoc_ros.cli.postures import posture, read_postures
from denoc_ros.dynamics.loop_response import LoopResponse, Swing, loop_response
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import ConfigError
from denoc_ros.output_files import write_text
from denoc_ros.reports.bode import page
from denoc_ros.reports.provenance import named_file, provenance

PAGE = 'bode.html'


def add_bode(parser: argparse.ArgumentParser) -> None:
    """Declare `--bode` and its options."""
    group = parser.add_argument_group('would a loop ring')
    group.add_argument(
        '--bode',
        action='append',
        metavar='IN:OUT',
        help="write a page with the frequency response from a joint's torque to a joint, a sensor "
        'or a frame (tool, or tool/x, /y, /z, /rx, /ry, /rz), its poles and zeros; repeatable',
    )
    group.add_argument(
        '--free',
        action='store_true',
        help='leave the other joints free; by default they are held',
    )


def run_bode(args: argparse.Namespace, robot: Robot) -> int:
    """Write the page, print its conclusion, and return the exit status."""
    pairs = _pairs(args.bode)
    postures = read_postures(robot, args.at) or [posture(robot, [0.0] * len(robot.joint_names))]
    ways = {
        pair: {place.name: loop_response(robot, place.q, *pair, args.free) for place in postures}
        for pair in pairs
    }
    file = Path(args.output or PAGE)
    source = given_file(args.robot, 'robot')
    made = provenance(args.command, {'robot': named_file(source)})
    shown = page(ways, robot.tree.name, args.free, made)
    write_text(file, shown.html())
    rows = [_summary(name, way) for places in ways.values() for name, way in places.items()]
    if args.json:
        print(json.dumps({'output': str(file), 'ways': rows}, indent=2, allow_nan=False))
        return 0
    print(file)
    for row in rows:
        print(f'{row["input"]} to {row["output"]}, joints at ({row["at"]}): {row["sentence"]}')
    return 0


def _pairs(given: list[str]) -> list[tuple[str, str]]:
    pairs = [text.partition(':') for text in given]
    wrong = [text for text, (a, _, b) in zip(given, pairs, strict=True) if not (a and b)]
    if wrong:
        findings = [f'--bode must be IN:OUT, such as joint_2:tool, got {text!r}' for text in wrong]
        raise ConfigError('command line', findings)
    return list(dict.fromkeys((a, b) for a, _, b in pairs))


def _summary(name: str, way: LoopResponse) -> dict[str, Any]:
    """Summary of one response at one posture, ready for JSON."""
    unstable = way.unstable_zero
    return {
        'input': way.input,
        'output': way.output,
        'at': name,
        'rings': way.rings,
        'sentence': way.sentence(),
        'poles': [_swing(one) for one in way.swinging_poles],
        'zeros': [_swing(one) for one in way.swinging_zeros],
        'unstable_zero_rad_s': unstable if unstable < float('inf') else None,
    }


def _swing(one: Swing) -> dict[str, float]:
    return {'frequency_hz': one.frequency, 'damping_ratio': one.damping_ratio}
