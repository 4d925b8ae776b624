"""A session's file session.json, and its end: a whole bag, summary.json and the report."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any

from denoc_ros.bags.reader import BAG_FOLDER
from denoc_ros.bags.recover import recover
from denoc_ros.cli.interrupts import Interrupt
from denoc_ros.cli.progress import Progress
from denoc_ros.cli.verbs import verbs
from denoc_ros.errors import DenocError
from denoc_ros.output_files import whole_file, write_text
from denoc_ros.parts import optional
from denoc_ros.simulation.recorded.run_files import SESSION_FILE
from denoc_ros.terminal_text import say

CUT_OFF = 'bag_cut_off'  # what a recorder left that did not end by itself
NO_REPORT = 'none: nothing was recorded'
NO_PART = "none: the part 'reports' is not there"
NEXT = ('view', 'replay', 'identify')  # verbs that take a run as it is
REPORTING = 5.0  # s that a report takes


class SessionFile:
    """`session.json` of a run's directory; each change is written at once, whole or not at all."""

    def __init__(self, folder: Path, values: dict[str, Any]) -> None:
        self.folder = folder
        self._file = folder / SESSION_FILE
        self._values = {**values, 'phases': []}
        self._phase_began = 0.0
        self._write()

    @property
    def phases(self) -> list[dict[str, Any]]:
        """The phases that have begun.

        `name`, `begin_ns`, `end_ns` (None: unfinished) and, of a finished one, `wall`: the seconds
        of wall time that it took. `model` and `plant`: the numbers of model and plant by dotted
        path, as far as the session gives them. `identified`: what an earlier phase told of the
        robot.
        """
        return list(self._values['phases'])

    @property
    def time(self) -> dict[str, Any]:
        """The session's time.

        `mode`, `why`, when the session began (`begun_ns`) and, once a phase is finished, `factor`:
        the recording's time over wall time, of all finished phases.
        """
        return dict(self._values.get('time', {}))

    def begin_phase(self, name: str, stamp_ns: int, **values: Any) -> None:
        """Note that a phase begins, or begins anew, by the clock of the recording [ns].

        Parameters
        ----------
        **values
            What else is noted of the phase; None stands for nothing.
        """
        self._phase_began = time.perf_counter()
        phases = self._values['phases']
        if phases and phases[-1]['end_ns'] is None:
            phases.pop()
        noted = {key: value for key, value in values.items() if value is not None}
        phases.append({'name': name, 'begin_ns': stamp_ns, 'end_ns': None, **noted})
        self._write()

    def end_phase(self, stamp_ns: int) -> None:
        """Note that the phase is finished, by the clock of the recording [ns]."""
        wall = time.perf_counter() - self._phase_began
        self._values['phases'][-1].update(end_ns=stamp_ns, wall=wall)
        finished = [each for each in self._values['phases'] if each['end_ns'] is not None]
        lasted = 1e-9 * sum(each['end_ns'] - each['begin_ns'] for each in finished)
        self.note(time={**self.time, 'factor': lasted / sum(each['wall'] for each in finished)})

    @property
    def notes(self) -> list[str]:
        """What a reader of the run must know, beyond its numbers."""
        return list(self._values.get('notes', []))

    def add_note(self, text: str) -> None:
        """Add a text to the notes."""
        self.note(notes=[*self.notes, text])

    def note(self, **values: Any) -> None:
        """Note other values, such as `failure`: why the session ended before its end."""
        self._values.update(values)
        self._write()

    def _write(self) -> None:
        with whole_file(self._file) as unfinished:
            unfinished.write_text(json.dumps(self._values, indent=2))


def conclude(
    folder: Path,
    file: SessionFile,
    error: BaseException | None,
    shares: dict[str, float],
    records: bool,
    progress: Progress,
) -> dict[str, Any]:
    """Write the results of a session: summary.json and, where it recorded, the report.

    Raises
    ------
    DenocError, OSError
        The report of a session that did not fail cannot be written.
    """
    failure = '' if error is None else cause(error)
    summary: dict[str, Any] = {'phases': {}, 'loops': {}}
    try:
        if failure:
            file.note(failure=failure)
        # before its first phase a session that is interrupted has nothing to tell
        if records and (file.phases or (failure and not isinstance(error, Interrupt))):
            _make_whole(folder, progress)
            if reports := optional('reports.report_verb'):
                with progress.step('writing the report', REPORTING):
                    summary = reports.write_report(folder, folder / 'report.html')
    except (DenocError, OSError) as second:
        if not failure:
            raise
        progress.say(f'no report: {second}')
    summary = {'run': str(folder), **summary, 'processor_share': shares}
    if failure:
        summary['failure'] = failure
    write_text(folder / 'summary.json', json.dumps(summary, indent=2, allow_nan=False))
    return summary


def cause(error: BaseException) -> str:
    """Return why a session ended before its end, in words."""
    if isinstance(error, KeyboardInterrupt):
        return 'interrupted'
    if isinstance(error, OSError):
        return f'{error.filename or "file"}: {error.strerror or error}'
    return str(error) if isinstance(error, DenocError) else f'{type(error).__name__}: {error}'


def _make_whole(folder: Path, progress: Progress) -> None:
    """Rebuild the bag of a recorder that could not finish it; the cut one is kept."""
    bag = folder / BAG_FOLDER
    if (bag / 'metadata.yaml').is_file() or not any(bag.glob('*.mcap')):
        return
    with progress.step('rebuilding the bag, which was cut off'):
        rebuilt = recover(bag).path
        bag.rename(folder / CUT_OFF)
        rebuilt.rename(bag)


def print_summary(summary: dict[str, Any], folder: Path) -> None:
    """Print the numbers of a run, and where it and its report are."""
    headline = optional('reports.headline')
    for line in headline.summary_lines(summary) if headline else ():
        say(line)
    report = folder / 'report.html'
    say(f'run     {folder}')
    missing = NO_REPORT if headline else NO_PART
    say(f'report  {report if report.is_file() else missing}')
    if (folder / BAG_FOLDER).is_dir():
        known = verbs()
        for k, name in enumerate(each for each in NEXT if each in known):
            say(f'{"" if k else "next":8}denoc {name} {folder}')
