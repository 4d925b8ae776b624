"""The page of a run as one self-contained HTML file, and its numbers."""

from __future__ import annotations

import base64
import io
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from markupsafe import Markup
from PIL.Image import Image

from denoc_ros.bags.reader import read_description
from denoc_ros.bags.run import Diagnostic, RecordedTopics, read_run
from denoc_ros.dynamics.robot import Robot, load_robot
from denoc_ros.errors import BagError, ConfigError, DenocError
from denoc_ros.model.joint_units import Units
from denoc_ros.output_files import write_text
from denoc_ros.pages.html_page import PageSection, ReportPage
from denoc_ros.pages.loop_timing import LoopMeasure, NodeWarnings, loop_measures, warnings
from denoc_ros.pages.provenance import named_file, named_text, provenance
from denoc_ros.parts import optional
from denoc_ros.reports import energy_balance, headline, sections
from denoc_ros.reports.headline import time_in_words
from denoc_ros.reports.measures import PhaseMeasures, measure, summarize
from denoc_ros.simulation.recorded.run_files import (
    EARTH,
    SIMULATED,
    STEPPED,
    find_bag,
    plant_of,
    read_session,
    recorded_phases,
    recording_name,
)
from denoc_ros.simulation.simulate import Run
from denoc_ros.simulation.simulated_bag import write_run

SIZE = (460, 360)  # pixels of one moment: readable at a phone's width
RATE = 20.0  # Hz, of the moments that are read: few are shown
COUNT = 6
NOTED = ('time', 'beams', 'failure', 'notes')  # of a session, in the numbers of its run


def moments(bag: Path, robot: Robot | None) -> PageSection | None:
    """Return the section, None where the bag does not show how the robot stood."""
    from denoc_ros.simulation.recorded.run_snapshots import RecordedRun

    film = optional('viewer.film')
    if robot is None or film is None:
        return None
    try:
        run = RecordedRun(bag, robot, rate=RATE)
        images = film.moment_images(run, robot, film.Look(size=SIZE), COUNT)
    except DenocError:
        return None
    shown = Markup('').join(
        Markup('<img alt="{}" width="{}" height="{}" src="data:image/png;base64,{}">').format(
            f'{robot.tree.name} at moment {k} of {COUNT} of the run', *image.size, _png(image)
        )
        for k, image in enumerate(images, 1)
    )
    said = (
        'The deflection is exaggerated by the factor in the pictures, the strain is not. '
        'For a film of the run: denoc view RUN --video FILE.mp4'
    )
    return PageSection('How it moved', said, picture=shown)


def _png(image: Image) -> str:
    picture = io.BytesIO()
    image.save(picture, 'png', optimize=True)
    return base64.b64encode(picture.getvalue()).decode()


@dataclass(frozen=True)
class Report:
    """The page of a run and its numbers."""

    page: ReportPage  # verdict, figures of merit, sections, provenance
    # errors, deflection, torque and loop timing in SI units, ready for JSON
    summary: dict[str, Any]
    notes: tuple[str, ...] = ()  # what the page leaves out, and why

    def html(self) -> str:
        """Return the page as one self-contained HTML file."""
        return self.page.html()

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write the page to a file; an existing file is replaced."""
        write_text(path, self.html())

    def _repr_html_(self) -> str:
        return self.html()


def report(
    run: str | os.PathLike[str] | Run,
    robot: Robot | None = None,
    command: str = '',
    phases: Sequence[str] = (),
) -> Report:
    """Return the page of a run and its numbers.

    Parameters
    ----------
    run : path or Run
        A directory made by `denoc up`, a bag such as `denoc simulate` writes, or what
        :func:`denoc_ros.simulate` returned.
    robot : Robot, optional
        The robot of a `Run`, which does not hold it; a bag brings its own.
    command : str
        The command line, for the page's foot.
    phases : sequence of str
        Names of those that are measured; default: all.

    Raises
    ------
    BagError
        When there is no readable bag.
    ConfigError
        For a `Run` without its robot, or a path with one.
    """
    if isinstance(run, Run) != (robot is not None):
        wanted = 'be given for a Run' if robot is None else 'be left out for a path'
        raise ConfigError('report', [f'robot must {wanted}, got run of {type(run).__name__}'])
    if robot is None:
        assert not isinstance(run, Run)
        return _of_path(Path(run), command, phases)
    assert isinstance(run, Run)
    with TemporaryDirectory() as folder:
        bag = Path(folder) / 'run.mcap'
        write_run(run, robot, bag, robot.tree.source, session=_session_of(robot))
        return _of_path(bag, command, phases)


def _session_of(robot: Robot) -> dict[str, Any]:
    return {
        'kind': SIMULATED,
        'name': robot.tree.name,
        'gravity': robot.gravity.tolist(),
        'geometric_stiffness': robot.geometric_stiffness,
        'model': dict(robot.tree.overrides),
    }


def _of_path(run_path: Path, command: str, names: Sequence[str]) -> Report:
    bag = find_bag(run_path)
    session = read_session(run_path)
    try:
        recording = read_run(bag, phases=session.get('phases', ()))
    except BagError as error:
        if 'failure' not in session:
            raise
        return _unrecorded(session, str(error), command)
    robot, notes = _robot(recording, session)
    tip = session.get('tip') or (list(robot.tree.frames)[-1] if robot else '')
    if names:
        recorded_phases(run_path, names)  # refuses a name that no phase has
    phases = measure(recording, robot, tip, names)
    statuses = recording.diagnostics()
    loops = loop_measures(statuses, recording.begin_ns)
    spans = [(each.name, recording.span_ns(each.begin, each.end)) for each in phases]
    warned = warnings(statuses, spans)
    simulated = None
    if robot is not None and session.get('kind') == SIMULATED:
        simulated = energy_balance.energy_balance(recording, robot)
    summary = {
        'bag': str(bag),
        'robot': session.get('robot', ''),
        'duration': recording.duration,
        'phases': summarize(phases),
        'loops': {loop.node: loop.summary() for loop in loops},
        'warnings': warned,
        'messages': recording.counts,
        'recorder': {status.name: status.values for status in statuses}.get(
            'recorder: recording', {}
        ),
        **({'simulated': simulated.summary()} if simulated else {}),
        **{key: session[key] for key in NOTED if key in session},
    }
    found = _Found(recording, session, robot, phases, loops, warned, statuses, simulated)
    return Report(_page(found, command), summary, notes)


def _unrecorded(session: Mapping[str, Any], why: str, command: str) -> Report:
    """Return the page of a session that failed before anything was recorded."""
    failure = session['failure']
    page = ReportPage(
        title=session.get('name', ''),
        subtitle='nothing recorded',
        verdict=headline.failed((), failure, Units.of(None), _cut(session)),
        cards=(),
        sections=[sections.failure(failure)],
        provenance=provenance(
            command, {'command of the run': session.get('command', '')}, session.get('versions')
        ),
    )
    numbers = {'phases': {}, 'loops': {}, 'failure': failure}
    return Report(page, numbers, (f'nothing is shown of the run: {why}',))


def _cut(session: Mapping[str, Any]) -> str:
    """Return the phase that had no end when the session ended, '' if there is none."""
    phases = session.get('phases', ())
    return next((phase['name'] for phase in phases if phase.get('end_ns') is None), '')


def _robot(
    recording: RecordedTopics, session: Mapping[str, Any]
) -> tuple[Robot | None, tuple[str, ...]]:
    """Return the recorded robot as the session had it, None if unknown, and why it is left out."""
    text = read_description(recording.path)
    if not text:
        return None, ()
    gravity = tuple(session.get('gravity', EARTH))
    try:
        robot = load_robot(text, gravity, session.get('geometric_stiffness', True))
        return plant_of(robot, session), ()
    except DenocError as error:
        return None, (f'the robot is left out: {error}',)


@dataclass(frozen=True)
class _Found:
    """All that a report shows."""

    recording: RecordedTopics
    session: dict[str, Any]
    robot: Robot | None
    phases: Sequence[PhaseMeasures]
    loops: Sequence[LoopMeasure]
    warned: dict[str, NodeWarnings]
    statuses: Sequence[Diagnostic]
    simulated: energy_balance.EnergyBalance | None


def _page(found: _Found, command: str) -> ReportPage:
    phases, duration = found.phases, found.recording.duration
    units = Units.of(found.robot.tree if found.robot else None)
    simulated = found.simulated
    return ReportPage(
        title=found.session.get('name') or recording_name(found.recording.path),
        subtitle=' · '.join(_subtitle(found)),
        verdict=energy_balance.verdict(simulated, headline.said(phases, units))
        if simulated
        else headline.verdict(
            phases,
            found.warned,
            duration,
            units,
            found.session.get('failure', ''),
            _cut(found.session),
        ),
        cards=[
            *(energy_balance.cards(simulated) if simulated else ()),
            *headline.cards(phases, found.loops, units),
        ],
        sections=[
            sections.failure(found.session.get('failure', '')),
            sections.notes(found.session.get('notes', ())),
            moments(found.recording.path, found.robot),
            sections.tip(phases),
            sections.identified(found.session.get('phases', ())),
            sections.tracking(phases, units),
            sections.motion(phases, units),
            sections.deflection(phases),
            sections.torque(phases, units),
            *(energy_balance.sections(simulated) if simulated else ()),
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
        mode: dict[str, Any] = session.get('time', {})
        stepped = mode.get('mode') == STEPPED
        begun_ns = mode.get('begun_ns', 0) if stepped else recording.origin_ns
        begun = datetime.fromtimestamp(begun_ns * 1e-9, tz=timezone.utc)
        yield begun.strftime('%Y-%m-%d %H:%M:%S UTC')
        yield f'{recording.duration:.1f} s {"of simulated time " if stepped else ""}recorded'
        if words := time_in_words(mode):
            yield words
    if robot := session.get('robot'):
        yield Path(robot).name
    if beams := session.get('beams'):
        yield str(beams)


def _provenance(found: _Found, command: str) -> dict[str, str]:
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
