"""`denoc check ROBOT`: parts of a robot, its frequency responses, a proposed flexibility."""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import Any

from denoc_ros.cli.arguments import add_gravity, add_json, add_option, add_output, given_file
from denoc_ros.cli.postures import add_postures, posture, read_postures
from denoc_ros.cli.provenance import named_file, provenance
from denoc_ros.cli.robot_text import robot_text, suggestion_text, summarize, summarize_suggestion
from denoc_ros.cli.session.session_config import find_file
from denoc_ros.cli.verb_result import VerbResult
from denoc_ros.cli.verbs import DOUBTFUL
from denoc_ros.dynamics.robot import Robot, load_robot
from denoc_ros.errors import ConfigError
from denoc_ros.output_files import write_new, write_text
from denoc_ros.reduction.suggest.suggestion import suggest_flexibility
from denoc_ros.reports.loop_response import LoopResponse, Swing, loop_response

PAGE = Path('bode.html')
OPTIONS = ('material', 'link', 'bandwidth', 'gears', 'output')
DESCRIPTION = (
    'Read a URDF with its <flexibility> block, report every finding in it, and list links, '
    'joints, beams, natural frequencies and masses.'
)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    add_option(parser, 'robot', 'the URDF file, in this folder or in the installed package')
    add_gravity(parser)
    add_json(parser)
    add_postures(parser)
    add_bode(parser)
    add_suggestion(parser)


def run(args: argparse.Namespace) -> VerbResult:
    """List the robot's parts, its frequency responses or proposed beams; errors are raised."""
    check_options(args)
    file = find_file(Path(args.robot), Path()) or args.robot
    if args.suggest:
        return run_suggestion(args, file)
    robot = load_robot(file, gravity=tuple(args.gravity))
    if args.bode:
        return run_bode(args, robot)
    summary = summarize(robot, read_postures(robot, args.at))
    warnings = [f'denoc check: warning: {warning}' for warning in summary['warnings']]
    return VerbResult(summary, [robot_text(summary)], notes=() if args.json else warnings)


def add_bode(parser: argparse.ArgumentParser) -> None:
    """Declare `--bode` and its options."""
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


def run_bode(args: argparse.Namespace, robot: Robot) -> VerbResult:
    """Write the page of frequency responses."""
    from denoc_ros.reports.bode import page  # here: it draws, and the check does not

    pairs = _pairs(args.bode)
    postures = read_postures(robot, args.at) or [posture(robot, [0.0] * len(robot.joint_names))]
    ways = {
        pair: {place.name: loop_response(robot, place.q, *pair, args.free) for place in postures}
        for pair in pairs
    }
    file = args.output or PAGE
    source = given_file(args.robot, 'robot')
    made = provenance(args.command, {'robot': named_file(source)})
    shown = page(ways, robot.tree.name, args.free, made)
    write_text(file, shown.html())
    rows = [_summary(name, way) for places in ways.values() for name, way in places.items()]
    lines = [
        f'{row["input"]} to {row["output"]}, joints at ({row["at"]}): {row["sentence"]}'
        for row in rows
    ]
    return VerbResult({'output': str(file), 'ways': rows}, [str(file), *lines])


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


def add_suggestion(parser: argparse.ArgumentParser) -> None:
    """Declare `--suggest` and its options."""
    group = parser.add_argument_group('a plain URDF becomes flexible')
    add_option(
        group,
        '--suggest',
        'propose beams for its links, from their inertia, joints, geometry and a material',
    )
    add_option(
        group,
        '--material NAME',
        'material: aluminium (the default), steel, titanium, magnesium, cfrp or gfrp',
    )
    add_option(
        group,
        '--link NAME',
        'make this link flexible in any case; repeatable; default: all links that bend enough',
        action='append',
    )
    add_option(
        group,
        '--bandwidth HZ',
        "bandwidth of the robot's control, default 10: links with a natural frequency "
        'below five times this become flexible, with modes up to ten times this',
        type=float,
    )
    add_option(
        group,
        '--gears NAME',
        'propose springs for its joints as well, by the effort limits, as gears of this '
        'kind would be: strain_wave, cycloidal or planetary; an assumption',
    )
    text = 'write the URDF with its beams and springs here, a new file; with --bode, the page'
    add_output(group, 'FILE', text)


def check_options(args: argparse.Namespace) -> None:
    """Refuse options that only go with `--suggest` or `--bode`."""
    given = [name for name in OPTIONS if getattr(args, name) is not None]
    stray = [] if args.suggest else [name for name in given if name != 'output' or not args.bode]
    findings = [f'--{name} must come with --suggest, got it alone' for name in stray]
    if args.free and not args.bode:
        findings.append('--free must come with --bode, got it alone')
    if args.suggest and (args.bode or args.at):
        findings.append('--suggest must come without --bode and --at, got both')
    ConfigError.raise_any('command line', findings)


def run_suggestion(args: argparse.Namespace, file: Path | str) -> VerbResult:
    """Propose and write; exit status 2 if no link bends enough."""
    wishes: dict[str, Any] = {'links': args.link, 'gravity': math.hypot(*args.gravity)}
    wishes |= {
        name: getattr(args, name)
        for name in ('material', 'bandwidth', 'gears')
        if getattr(args, name) is not None
    }
    suggestion = suggest_flexibility(file, **wishes)
    robot = load_robot(suggestion.text, gravity=tuple(args.gravity))
    row = summarize_suggestion(suggestion, robot)
    proposed = bool(suggestion.springs) or any(beam.worth for beam in suggestion.beams)
    if args.output and proposed:
        write_new(args.output, suggestion.text)
        row['written'] = str(args.output)
    warnings = [f'denoc check: warning: {warning}' for warning in robot.tree.warnings]
    return VerbResult(row, [suggestion_text(row)], 0 if proposed else DOUBTFUL, warnings)
