"""Health of a session's nodes, by their messages and by the activity of their processes."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

from denoc_ros.cli.processes import Activity, ProcessError

LOOK = 1.0  # s between looks
LONGEST_LOOK = 2.0  # s: a look that comes later says nothing of what the others do
STOPPED = 3.0  # s for which a process may be stopped
HUNG = 10.0  # s of silence of a process that waits and uses no processor
SILENT = 60.0  # s of silence of one that works, or waits for a processor
IDLE = 0.02  # share of a core up to which a process does nothing
STARVED = 8.0  # s in which a process waits for a processor nearly all the time
WANTED = 0.7  # share of the time for which it wants one, at least
GRANTED = 0.02  # share of that time for which it gets one, at most
CARRIED = 0.5  # least share of its deadlines that a loop must meet
BEHIND = 5  # reports in a row, one a second, in which it did not
UNWATCHED = ('viewer',)  # it has the lowest priority: a session goes on without it


class Speaker(Protocol):
    """Listener to the nodes' messages on /diagnostics."""

    def reports(self, name: str) -> int:
        """Return how often a node has spoken."""

    def diagnostics(self, status: str) -> Mapping[str, str]:
        """Return the last values of a status."""

    def failure(self, status: str) -> str:
        """Return the message of a status that is an error, else ''."""


class Tasks(Protocol):
    """Observer of the nodes' processes."""

    def activity(self, name: str) -> Activity | None:
        """Return a process's activity."""

    def give_up(self, name: str) -> None:
        """Expect no orderly end of a process."""


@dataclass
class _Watched:
    """Health of one node so far."""

    reports: int = 0
    silent: float = 0.0  # s
    stopped: float = 0.0  # s
    cpu: float = math.nan  # at its last word [s]
    starved: float = 0.0  # s
    last: Activity | None = None  # at the last look
    ticks: tuple[int, int] | None = None  # taken and skipped
    behind: int = 0  # reports


@dataclass
class Health:
    """Watches nodes of a session; `check` raises as one can do its work no longer.

    Time counts only while this process itself has its turns: on a machine that pauses, or that is
    too busy for the session, nobody can be heard.

    Attributes
    ----------
    tasks : Tasks
        The processes.
    speaker : Speaker
        What nodes say.
    real_time : bool
        Whether loops must meet their deadlines.
    moves : bool
        Whether a phase is on, in which loops that fall behind spoil what is measured.
    """

    tasks: Tasks
    speaker: Speaker
    real_time: bool = True
    moves: bool = False
    _watched: dict[str, _Watched] = field(default_factory=dict)
    _looked: float = -math.inf

    def watch(self, name: str) -> None:
        """Watch a node from here on, as one that was just started."""
        if name not in UNWATCHED:
            self._watched[name] = _Watched()

    def forget(self, name: str) -> None:
        """Watch a node no longer: it is about to end."""
        self._watched.pop(name, None)

    def check(self) -> None:
        """Look at all nodes, if it is time to.

        Raises
        ------
        ProcessError
            A process is stopped, hangs or starves; a loop is too late; the recording has ended.
        """
        now = time.perf_counter()
        if now - self._looked < LOOK:
            return
        # a longer pause was one of this process
        passed = min(now - self._looked, LONGEST_LOOK)
        self._looked = now
        for name, watched in self._watched.items():
            activity = self.tasks.activity(name)
            if activity is not None:
                self._judge_process(name, watched, activity, passed)
                if self.moves and self.real_time:
                    self._judge_share(name, watched, activity, passed)
                    self._judge_loop(name, watched)
        if failure := self.speaker.failure('recorder: recording'):
            raise ProcessError(f'recorder: recording must go on, got: {failure}')

    def stands(self) -> bool:
        """Say whether a process is stopped just now."""
        found = map(self.tasks.activity, self._watched)
        return any(activity is not None and activity.stopped for activity in found)

    def _judge_process(
        self, name: str, watched: _Watched, activity: Activity, passed: float
    ) -> None:
        watched.stopped = watched.stopped + passed if activity.stopped else 0.0
        if watched.stopped > STOPPED:
            raise ProcessError(
                f'{name}: process must keep running, got one that has been stopped for '
                f'{watched.stopped:.0f} s (SIGSTOP or a debugger; SIGCONT would let it go on)'
            )
        said = self.speaker.reports(name)
        if said != watched.reports or said == 0:
            watched.reports, watched.silent, watched.cpu = said, 0.0, activity.cpu
            return
        watched.silent += passed
        used = activity.cpu - watched.cpu
        idle = not activity.runs and used < IDLE * watched.silent
        if watched.silent > (HUNG if idle else SILENT):
            does = 'waits' if idle else 'works'
            raise ProcessError(
                f'{name}: node must report on /diagnostics once a second, got '
                f'{watched.silent:.0f} s of silence of a process that {does}: it has used '
                f'{used:.1f} s of processor time'
            )

    def _judge_share(
        self, name: str, watched: _Watched, activity: Activity, passed: float
    ) -> None:
        """Raise where a process gets next to nothing of a processor, though it wants one."""
        before, watched.last = watched.last, activity
        if before is None or passed >= LONGEST_LOOK:
            return
        # the kernel counts a delay as it ends: a thread may have waited all the time
        wants = activity.runs or activity.delay - before.delay > WANTED * passed
        starves = wants and activity.cpu - before.cpu < GRANTED * passed
        watched.starved = watched.starved + passed if starves else 0.0
        if watched.starved > STARVED:
            self.tasks.give_up(name)
            raise ProcessError(
                f'{name}: process must get a processor, got one for less than '
                f'{100.0 * GRANTED:.0f} % of {watched.starved:.0f} s: it starves beside others'
            )

    def _judge_loop(self, name: str, watched: _Watched) -> None:
        """Raise where a loop meets too few deadlines, report after report."""
        values = self.speaker.diagnostics(f'{name}: loop')
        if 'skipped_total' not in values:
            return
        now = int(values['ticks']), int(values['skipped_total'])
        before, watched.ticks = watched.ticks, now
        if before is None or now == before or now[0] < before[0]:
            return
        taken, skipped = now[0] - before[0], now[1] - before[1]
        late = taken < CARRIED * (taken + skipped)
        watched.behind = watched.behind + 1 if late else 0
        if watched.behind >= BEHIND:
            nominal = float(values['nominal_rate_hz'])
            share = taken / (taken + skipped)
            raise ProcessError(
                f'{name}: loop must tick at {nominal:g} Hz, got {share * nominal:.0f} Hz for '
                f'{BEHIND} s: the process starves, or the machine is too slow for this session in '
                'real time (lower update_rate, or run it with --time simulated)'
            )
