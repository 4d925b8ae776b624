"""The file of a session: its programs, its phases with their times, its cause of an early end."""

from __future__ import annotations

import json
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
        self._write()

    @property
    def phases(self) -> list[dict[str, Any]]:
        """`name`, `begin_ns` and `end_ns` (None: unfinished) of each phase that has begun."""
        return list(self._values['phases'])

    @property
    def time(self) -> dict[str, Any]:
        """`mode` of the session's time, `why`, and when the session began (`begun_ns`)."""
        return dict(self._values.get('time', {}))

    def begin_phase(self, name: str, stamp_ns: int) -> None:
        """Note that a phase begins, by the clock of the recording [ns]."""
        self._values['phases'].append({'name': name, 'begin_ns': stamp_ns, 'end_ns': None})
        self._write()

    def end_phase(self, stamp_ns: int) -> None:
        """Note that the phase is finished, by the clock of the recording [ns]."""
        self._values['phases'][-1]['end_ns'] = stamp_ns
        self._write()

    def note(self, **values: Any) -> None:
        """Note other values, such as `failure`: why the session ended before its end."""
        self._values.update(values)
        self._write()

    def _write(self) -> None:
        with whole_file(self._file) as unfinished:
            unfinished.write_text(json.dumps(self._values, indent=2))
