"""`denoc check ROBOT`: parts of a robot, its frequency responses, a proposed flexibility."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from denoc_ros.cli.arguments import add_gravity, add_json, add_option, add_output
from denoc_ros.cli.postures import add_postures, read_postures
from denoc_ros.cli.robot_text import robot_text, summarize
from denoc_ros.cli.session.session_config import find_file
from denoc_ros.cli.verb_result import VerbResult
from denoc_ros.cli.verbs import BAD_INPUT, DOUBTFUL
from denoc_ros.dynamics.robot import load_robot
from denoc_ros.errors import ConfigError, DenocError
from denoc_ros.parts import optional

# what else the verb does: the option that asks for it, and the module of the part that does it
WAYS = {'suggest': 'reduction.suggest.suggest_option', 'bode': 'reports.bode_option'}
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
    ways = _ways()
    for way in ways.values():
        way.add_options(parser)
    if ways:
        text = 'write the URDF with its beams and springs here, a new file; with --bode, the page'
        add_output(parser, 'FILE', text)


def _ways() -> dict[str, Any]:
    """Return the modules of the options whose parts are there."""
    found = {option: optional(module) for option, module in WAYS.items()}
    return {option: module for option, module in found.items() if module is not None}


def run(args: argparse.Namespace) -> VerbResult:
    """List the robot's parts, its frequency responses or proposed beams.

    Exit status 2 with warnings. Errors are raised; with `--json` they are printed as well.
    """
    check_options(args)
    file = find_file(Path(args.robot), Path()) or args.robot
    for option, way in _ways().items():
        if getattr(args, option):
            found: VerbResult = way.run(args, file)
            return found
    try:
        robot = load_robot(file, gravity=tuple(args.gravity))
        summary = summarize(robot, read_postures(robot, args.at))
    except DenocError as error:
        if not args.json:
            raise
        lines = str(error).splitlines()
        document = {'errors': lines, 'warnings': [], 'hints': []}
        return VerbResult(document, (), BAD_INPUT, [f'denoc check: {line}' for line in lines])
    warnings = [f'denoc check: warning: {warning}' for warning in summary['warnings']]
    status = DOUBTFUL if warnings else 0
    return VerbResult(summary, [robot_text(summary)], status, () if args.json else warnings)


def check_options(args: argparse.Namespace) -> None:
    """Refuse options that only go with `--suggest` or `--bode`."""
    given = [name for name in OPTIONS if getattr(args, name, None) is not None]
    suggest, bode = (getattr(args, name, None) for name in ('suggest', 'bode'))
    stray = [] if suggest else [name for name in given if name != 'output' or not bode]
    findings = [f'--{name} must come with --suggest, got it alone' for name in stray]
    if getattr(args, 'free', False) and not bode:
        findings.append('--free must come with --bode, got it alone')
    if suggest and (bode or args.at):
        findings.append('--suggest must come without --bode and --at, got both')
    ConfigError.raise_any('command line', findings)
