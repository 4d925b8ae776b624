"""`denoc report RUN`: one self-contained HTML page of a run or a bag."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from denoc_ros.bags.reader import BAG_FOLDER
from denoc_ros.cli.arguments import add_json, add_option, add_output, add_phase, unused
from denoc_ros.cli.verb_result import VerbResult
from denoc_ros.reports.run_page import report
from denoc_ros.simulation.recorded.run_files import recording_name
from denoc_ros.terminal_text import say

DESCRIPTION = (
    'Write one HTML page with tracking, predicted and true deflection, torque, loop periods, '
    'node statistics, and for a simulation energy and closure of loops; as far as the bag has '
    'them.'
)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    add_option(parser, 'run RUN', "a run's directory, or a bag", type=Path)
    add_output(
        parser, 'FILE', 'file of the page; default: report.html in the run, or BAG.html here'
    )
    add_phase(parser)
    add_json(parser)


def run(args: argparse.Namespace) -> VerbResult:
    """Write the page; errors are raised."""
    output = args.output or default_output(args.run)
    summary = write_report(args.run, output, args.command, args.phase)
    return VerbResult(summary, [str(output)])


def default_output(run_path: Path) -> Path:
    """Return the default path of the page."""
    if (run_path / BAG_FOLDER).is_dir():
        return run_path / 'report.html'
    return unused(Path(f'{recording_name(run_path)}.html'))


def write_report(
    run_path: Path, output: Path, command: str = '', phases: Sequence[str] = ()
) -> dict[str, Any]:
    """Write a run's page, print its omissions on stderr, return its numbers."""
    made = report(run_path, command=command, phases=phases)
    for note in made.notes:
        say(f'denoc report: {note}', file=sys.stderr)
    made.write(output)
    return made.summary
