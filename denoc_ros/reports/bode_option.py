"""`denoc check --bode`: frequency responses from a joint's torque, as a page."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from denoc_ros.cli.arguments import add_option, given_file
from denoc_ros.cli.postures import posture, read_postures
from denoc_ros.cli.verb_result import VerbResult
from denoc_ros.dynamics.robot import load_robot
from denoc_ros.errors import ConfigError
from denoc_ros.output_files import write_text
from denoc_ros.pages.provenance import named_file, provenance
from denoc_ros.reports.loop_response import LoopResponse, Swing, loop_response

PAGE = Path('bode.html')


def add_options(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    group = parser.add_argument_group('would a loop ring')
    add_option(
        group,
        '--bode IN:OUT',
        "write a page with the frequency response from a joint's torque to a joint, a "
        'sensor or a frame (tool, or tool/x, /y, /z, /rx, /ry, /rz), its poles and '
        'zeros; repeatable',
        action='append',
    )
    add_option(group, '--free', 'leave the other joints free; by default they are held')


def run(args: argparse.Namespace, file: Path | str) -> VerbResult:
    """Write the page of frequency responses of a robot's file."""
    from denoc_ros.reports.bode import page  # here: it draws, and the check does not

    robot = load_robot(file, gravity=tuple(args.gravity))
    pairs = _pairs(args.bode)
    postures = read_postures(robot, args.at) or [posture(robot, [0.0] * len(robot.joint_names))]
    ways = {
        pair: {place.name: loop_response(robot, place.q, *pair, args.free) for place in postures}
        for pair in pairs
    }
    output = args.output or PAGE
    source = given_file(args.robot, 'robot')
    made = provenance(args.command, {'robot': named_file(source)})
    shown = page(ways, robot.tree.name, args.free, made)
    write_text(output, shown.html())
    rows = [_summary(name, way) for places in ways.values() for name, way in places.items()]
    lines = [
        f'{row["input"]} to {row["output"]}, joints at ({row["at"]}): {row["sentence"]}'
        for row in rows
    ]
    return VerbResult({'output': str(output), 'ways': rows}, [str(output), *lines])


def _pairs(given: list[str]) -> list[tuple[str, str]]:
    pairs = [text.partition(':') for text in given]
    wrong = [text for text, (a, _, b) in zip(given, pairs, strict=True) if not (a and b)]
    if wrong:
        findings = [f'--bode must be IN:OUT, such as joint_2:tool, got {text!r}' for text in wrong]
        raise ConfigError('command line', findings)
    return list(dict.fromkeys((a, b) for a, _, b in pairs))


def _summary(name: str, way: LoopResponse) -> dict[str, Any]:
    return {
        'input': way.input,
        'output': way.output,
        'at': name,
        'rings': way.rings,
        'sentence': way.sentence(),
        'poles': [_swing(one) for one in way.swinging_poles],
        'zeros': [_swing(one) for one in way.swinging_zeros],
        'unstable_zero_rad_s': way.unstable_zero,
    }


def _swing(one: Swing) -> dict[str, float]:
    return {'frequency_hz': one.frequency, 'damping_ratio': one.damping_ratio}
