"""The file of a session: its programs, its phases with their times, its cause of an early end."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any

from denoc_ros.output_files import whole_file
from denoc_ros.reports.run_files import SESSION_FILE


class SessionFile:
    """`session.json` of a run's directory; each change is written at once, whole or not at all.

    Parameters
    ----------
    folder : Path
        The run's directory.
    values : dict
        What is known when the session begins, ready for JSON.

    Attributes
    ----------
    folder : Path
        The run's directory.
    """

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
        of wall time that it took.
        """
        return list(self._values['phases'])

    @property
    def time(self) -> dict[str, Any]:
        """The session's time.

        `mode`, `why`, when the session began (`begun_ns`) and, once a phase is finished, `factor`:
        the recording's time over wall time, of all finished phases.
        """
        return dict(self._values.get('time', {}))

    def begin_phase(self, name: str, stamp_ns: int) -> None:
        """Note that a phase begins, by the clock of the recording [ns]."""
        self._phase_began = time.perf_counter()
        self._values['phases'].append({'name': name, 'begin_ns': stamp_ns, 'end_ns': None})
        self._write()

    def end_phase(self, stamp_ns: int) -> None:
        """Note that the phase is finished, by the clock of the recording [ns]."""
        wall = time.perf_counter() - self._phase_began
        self._values['phases'][-1].update(end_ns=stamp_ns, wall=wall)
        finished = [each for each in self._values['phases'] if each['end_ns'] is not None]
        lasted = 1e-9 * sum(each['end_ns'] - each['begin_ns'] for each in finished)
        self.note(time={**self.time, 'factor': lasted / sum(each['wall'] for each in finished)})

    def note(self, **values: Any) -> None:
        """Note other values, such as `failure`: why the session ended before its end."""
        self._values.update(values)
        self._write()

    def _write(self) -> None:
        with whole_file(self._file) as unfinished:
            unfinished.write_text(json.dumps(self._values, indent=2))
