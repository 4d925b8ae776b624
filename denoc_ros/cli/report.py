"""`denoc report RUN`: one self-contained HTML page of what a run or a bag shows."""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path
from typing import TYPE_CHECKING, Any

from denoc_ros.cli.arguments import EARTH, recording_name, unused
from denoc_ros.errors import BagError, DenocError

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from denoc_ros.bags.series import Diagnostic
    from denoc_ros.cli.balance import Balance
    from denoc_ros.cli.measures import LoopMeasure, PhaseMeasures
    from denoc_ros.cli.pages import Page
    from denoc_ros.cli.recording import Recording
    from denoc_ros.dynamics.robot import Robot

BAG_FOLDER = 'bag'
SESSION_FILE = 'session.json'
SESSION_KINDS: dict[str, type] = {
    **dict.fromkeys(('kind', 'name', 'robot', 'tip', 'command', 'scenario'), str),
    **dict.fromkeys(('model', 'versions'), dict),
    'gravity': list,
    'geometric_stiffness': bool,
}
SIMULATED = 'simulate'  # kind of a session


def add_parser(subparsers: Any) -> None:
    """Declare the verb's arguments."""
    parser = subparsers.add_parser(
        'report',
        help='write the HTML report of a run or of any bag',
        description='Write one HTML page: tracking, deflection predicted over true, torque, loop '
        'periods, node statistics, energy and closed loops of a simulation; whatever of these the '
        'bag has.',
    )
    parser.add_argument('run', metavar='RUN', type=Path, help="a run's directory, or a bag")
    parser.add_argument(
        '-o',
        '--output',
        metavar='FILE',
        type=Path,
        help='default: report.html in the run, or BAG.html here',
    )
    parser.add_argument('--json', action='store_true', help='print the numbers as JSON')


def run(args: argparse.Namespace) -> int:
    """Run the verb and return the exit status; errors are raised."""
    page, summary = make_report(args.run, args.command)
    output = args.output or default_output(args.run)
    output.write_text(page, encoding='utf-8')
    print(json.dumps(summary, indent=2, allow_nan=False) if args.json else output)
    return 0


def default_output(run_path: Path) -> Path:
    """Return where the page goes when nothing is said."""
    if (run_path / BAG_FOLDER).is_dir():
        return run_path / 'report.html'
    return unused(Path(f'{recording_name(run_path)}.html'))


def make_report(run_path: Path, command: str = '') -> tuple[str, dict[str, Any]]:
    """Return a run's HTML page and its numbers.

    Parameters
    ----------
    run_path : Path
        A directory made by `denoc up`, or a bag, such as `denoc simulate` writes.
    command : str
        The command line, for the page's foot.

    Raises
    ------
    BagError
        When there is no readable bag.
    """
    from denoc_ros.cli.balance import balance
    from denoc_ros.cli.measures import loop_measures, measure, summarize, warnings
    from denoc_ros.cli.recording import Recording

    bag = find_bag(run_path)
    session = read_session(run_path)
    recording = Recording(bag)
    robot = _robot(recording, session)
    tip = session.get('tip') or (list(robot.tree.frames)[-1] if robot else '')
    phases = measure(recording, robot, tip)
    statuses = recording.diagnostics()
    loops = loop_measures(statuses, recording.begin_ns)
    warned = warnings(statuses, recording.begin_ns)
    simulated = None
    if robot is not None and session.get('kind') == SIMULATED:
        simulated = balance(recording, robot)
    summary = {
        'bag': str(bag),
        'robot': session.get('robot', ''),
        'duration': recording.duration,
        'phases': summarize(phases),
        'loops': {loop.node: loop.summary() for loop in loops},
        'warnings': warned,
        'messages': recording.counts,
        'recorder': _latest(statuses).get('recorder: recording', {}),
        **({'simulated': simulated.summary()} if simulated else {}),
    }
    found = _Found(recording, session, robot, phases, loops, warned, statuses, simulated)
    return _page(found, command).html(), summary


def find_bag(run_path: Path) -> Path:
    """Return the bag of a run's directory, or the bag itself."""
    if not run_path.exists():
        raise BagError(f'{run_path}: run must be a directory or a bag, got nothing there')
    inside = run_path / BAG_FOLDER
    return inside if inside.is_dir() else run_path


def read_session(run_path: Path) -> dict[str, Any]:
    """Return what a run's directory, or a bag of `denoc simulate`, says of it; else nothing."""
    from denoc_ros.bags.reader import SESSION_ATTACHMENT, read_attachment

    file = run_path / SESSION_FILE
    try:
        if file.is_file():
            text = file.read_bytes()
        else:
            text = read_attachment(run_path, SESSION_ATTACHMENT)
    except BagError:
        return {}
    try:
        session = json.loads(text)
    except ValueError as error:
        raise BagError(f'{run_path}: {SESSION_FILE} must be JSON, got: {error}') from error
    kinds = [(name, SESSION_KINDS.get(name)) for name in session if isinstance(session, dict)]
    wrong = [name for name, kind in kinds if kind and not isinstance(session[name], kind)]
    if wrong or not isinstance(session, dict):
        raise BagError(
            f'{run_path}: {SESSION_FILE} must be what denoc up or simulate wrote, got other '
            f'values: {", ".join(wrong) or repr(session)[:60]}'
        )
    return session


def _robot(recording: Recording, session: dict[str, Any]) -> Robot | None:
    """Return the recorded robot as the session had it; None where it is not known."""
    from denoc_ros.bags.reader import read_description
    from denoc_ros.dynamics.robot import load_robot

    text = read_description(recording.path)
    if not text:
        return None
    gravity = tuple(session.get('gravity', EARTH))
    try:
        robot = load_robot(text, gravity, session.get('geometric_stiffness', True))
        overrides = session.get('model', {})
        return robot.with_overrides(overrides) if overrides else robot
    except DenocError as error:
        print(f'denoc report: the robot is left out: {error}', file=sys.stderr)
        return None


def _latest(statuses: Sequence[Diagnostic]) -> dict[str, dict[str, str]]:
    return {status.name: status.values for status in statuses}


@dataclass(frozen=True)
class _Found:
    """All that a report shows."""

    recording: Recording
    session: dict[str, Any]
    robot: Robot | None
    phases: Sequence[PhaseMeasures]
    loops: Sequence[LoopMeasure]
    warned: dict[str, tuple[int, str]]
    statuses: Sequence[Diagnostic]
    simulated: Balance | None


def _page(found: _Found, command: str) -> Page:
    from denoc_ros.cli import balance, sections
    from denoc_ros.cli.moments_section import moments
    from denoc_ros.cli.pages import Page

    phases, duration = found.phases, found.recording.duration
    units = sections.Units.of(found.robot.tree if found.robot else None)
    simulated = found.simulated
    return Page(
        title=found.session.get('name') or recording_name(found.recording.path),
        subtitle=' · '.join(_subtitle(found)),
        verdict=balance.verdict(simulated, sections.said(phases, units))
        if simulated
        else sections.verdict(phases, found.warned, duration, units),
        cards=[
            *(balance.cards(simulated) if simulated else ()),
            *sections.cards(phases, found.loops, units),
        ],
        sections=[
            moments(found.recording.path, found.robot),
            sections.tracking(phases, units),
            sections.motion(phases, units),
            sections.deflection(phases),
            sections.torque(phases, units),
            *(balance.sections(simulated) if simulated else ()),
            sections.loops(found.loops),
            sections.warned(found.warned),
            sections.nodes(found.statuses),
            sections.topics(found.recording),
        ],
        provenance=_provenance(found, command),
    )


def _subtitle(found: _Found) -> Iterator[str]:
    recording, session = found.recording, found.session
    if session.get('kind') == SIMULATED:
        yield f'{recording.duration:.4g} s simulated'
    else:
        begun = datetime.fromtimestamp(recording.origin_ns * 1e-9, tz=timezone.utc)
        yield begun.strftime('%Y-%m-%d %H:%M:%S UTC')
        yield f'{recording.duration:.1f} s recorded'
    if robot := session.get('robot'):
        yield Path(robot).name


def _provenance(found: _Found, command: str) -> dict[str, str]:
    from denoc_ros.cli.provenance import named_file, named_text, provenance

    session = found.session
    name = Path(session.get('robot', '')).name or 'the one in the bag'
    ran = session.get('command', '')
    sources = {
        'command of the run': ran if ran != command else '',
        'bag': named_file(found.recording.path),
        'robot': named_text(name, found.robot.tree.source) if found.robot else '',
        'scenario': session.get('scenario', ''),
    }
    return provenance(command, sources, session.get('versions'))
