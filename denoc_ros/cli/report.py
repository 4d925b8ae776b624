"""`denoc report RUN`: one self-contained HTML page of what a run or a bag shows."""

from __future__ import annotations

import argparse
import json
import sys
from datetime import datetime, timezone
from pathlib import Path
from typing import TYPE_CHECKING, Any

from denoc_ros.errors import BagError, DenocError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from denoc_ros.bags.series import Diagnostic
    from denoc_ros.cli.measures import LoopMeasure, PhaseMeasures
    from denoc_ros.cli.recording import Recording
    from denoc_ros.dynamics.robot import Robot

BAG_FOLDER = 'bag'
SESSION_FILE = 'session.json'


def add_parser(subparsers: Any) -> None:
    """Declare the verb's arguments."""
    parser = subparsers.add_parser(
        'report',
        help='write the HTML report of a run or of any bag',
        description='Write one HTML page: tracking, deflection predicted over true, torque, loop '
        'periods, node statistics; whatever of these the bag has.',
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
    page, summary = make_report(args.run)
    output = args.output or default_output(args.run)
    output.write_text(page, encoding='utf-8')
    print(json.dumps(summary, indent=2, allow_nan=False) if args.json else output)
    return 0


def default_output(run_path: Path) -> Path:
    """Return where the page goes when nothing is said."""
    if (run_path / BAG_FOLDER).is_dir():
        return run_path / 'report.html'
    return Path(f'{run_path.resolve().stem}.html')


def make_report(run_path: Path) -> tuple[str, dict[str, Any]]:
    """Return a run's HTML page and its numbers.

    Parameters
    ----------
    run_path : Path
        A directory made by `denoc up`, or a bag.

    Raises
    ------
    BagError
        When there is no readable bag.
    """
    from denoc_ros.cli.measures import loop_measures, measure, summarize, warnings
    from denoc_ros.cli.recording import Recording

    bag = find_bag(run_path)
    session = read_session(run_path)
    recording = Recording(bag)
    robot, tip = _robot(recording, session)
    phases = measure(recording, robot, tip)
    statuses = recording.diagnostics()
    loops = loop_measures(statuses, recording.begin_ns)
    warned = warnings(statuses, recording.begin_ns)
    summary = {
        'bag': str(bag),
        'robot': session.get('robot', ''),
        'duration': recording.duration,
        'phases': summarize(phases),
        'loops': {loop.node: loop.summary() for loop in loops},
        'warnings': warned,
        'messages': recording.counts,
        'recorder': _latest(statuses).get('recorder: recording', {}),
    }
    return _render(recording, session, phases, loops, warned, statuses), summary


def find_bag(run_path: Path) -> Path:
    """Return the bag of a run's directory, or the bag itself."""
    if not run_path.exists():
        raise BagError(f'{run_path}: run must be a directory or a bag, got nothing there')
    inside = run_path / BAG_FOLDER
    return inside if inside.is_dir() else run_path


def read_session(run_path: Path) -> dict[str, Any]:
    """Return what a run's directory says of it; nothing for a bare bag."""
    file = run_path / SESSION_FILE
    return dict(json.loads(file.read_text(encoding='utf-8'))) if file.is_file() else {}


def _robot(recording: Recording, session: dict[str, Any]) -> tuple[Robot | None, str]:
    """Return the recorded robot and its tip, for the tip's error; None where it is not known."""
    from denoc_ros.bags.reader import read_description

    text = read_description(recording.path)
    if not text or 'plant/true_modal_state' not in ' '.join(recording.topics):
        return None, ''
    from denoc_ros.dynamics.robot import load_robot

    try:
        robot = load_robot(text, gravity=tuple(session.get('gravity', (0.0, 0.0, -9.81))))
    except DenocError as error:
        print(f'denoc report: tip error left out: {error}', file=sys.stderr)
        return None, ''
    return robot, session.get('tip') or list(robot.tree.frames)[-1]


def _latest(statuses: Sequence[Diagnostic]) -> dict[str, dict[str, str]]:
    return {status.name: status.values for status in statuses}


def _render(
    recording: Recording,
    session: dict[str, Any],
    phases: Sequence[PhaseMeasures],
    loops: Sequence[LoopMeasure],
    warned: dict[str, tuple[int, str]],
    statuses: Sequence[Diagnostic],
) -> str:
    from denoc_ros.cli import sections
    from denoc_ros.cli.pages import render_page

    begun = datetime.fromtimestamp(recording.origin_ns * 1e-9, tz=timezone.utc)
    return render_page(
        'report.html.j2',
        title=session.get('name') or recording.path.resolve().stem,
        begun=begun.strftime('%Y-%m-%d %H:%M:%S UTC'),
        session=session,
        duration=recording.duration,
        cards=sections.cards(phases, loops),
        sections=[
            section
            for section in (
                sections.tracking(phases),
                sections.deflection(phases),
                sections.torque(phases),
                sections.motion(phases),
                sections.loops(loops),
                sections.warned(warned),
                sections.nodes(statuses),
                sections.topics(recording),
            )
            if section is not None
        ],
    )
