"""Processes of a session's nodes: started, watched, ended; their health by messages."""

from __future__ import annotations

import ctypes
import math
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple, Protocol

from denoc_ros.errors import DenocError

LAST_LINES = 12  # of a dead process's output that the error shows
# s: how long a process may take to answer each signal before the next, harder one
PATIENCE = ((signal.SIGINT, 30.0), (signal.SIGTERM, 3.0), (signal.SIGKILL, 3.0))
HURRIED = ((signal.SIGINT, 3.0), (signal.SIGKILL, 3.0))  # for one that gets no processor
DOMAINS = range(1, 101)  # above 101 the ports would meet the ephemeral ones
PR_SET_PDEATHSIG = 1
STOPPED_STATES = 'Tt'  # of /proc: by a signal, by a debugger
LOOK = 1.0  # s between looks
LONGEST_LOOK = 2.0  # s: a look that comes later says nothing of what the others do
STOPPED = 3.0  # s for which a process may be stopped
HUNG = 10.0  # s of silence of a process that waits and uses no processor
LONGEST_SILENCE = 60.0  # s of silence of one that works, or waits for a processor
IDLE = 0.02  # share of a core up to which a process does nothing
STARVED = 8.0  # s in which a process waits for a processor nearly all the time
WANTED = 0.7  # share of the time for which it wants one, at least
GRANTED = 0.02  # share of that time for which it gets one, at most
CARRIED = 0.5  # least share of its deadlines that a loop must meet
BEHIND = 5  # reports in a row, one a second, in which it did not
UNWATCHED = ('viewer',)  # it has the lowest priority: a session goes on without it


class ProcessError(DenocError):
    """A process of the session ended when it should not have."""


class Activity(NamedTuple):
    """Activity of a process."""

    stopped: bool  # by SIGSTOP or a debugger
    runs: bool  # whether a thread runs or wants a processor; otherwise all wait for something
    cpu: float  # processor time that it has used [s]
    delay: float = 0.0  # how long its threads have waited for a processor, all together [s]


class Processes:
    """Child processes by name.

    Parameters
    ----------
    logs : Path
        Existing directory for `<name>.log`: what each writes to stdout and stderr.
    environment : mapping
        Added to this process's own.
    """

    def __init__(self, logs: Path, environment: Mapping[str, str]) -> None:
        self._logs = logs
        self._environment = {
            **os.environ,
            **environment,
            'PYTHONUNBUFFERED': '1',
            # For libraries that start Python themselves; ours have `python_start` on any Python.
            'PYTHONSAFEPATH': '1',
        }
        self._running: dict[str, subprocess.Popen[bytes]] = {}
        self._ending: set[str] = set()
        self._hopeless: set[str] = set()

    def start(self, name: str, arguments: Sequence[str], ends: bool = False) -> None:
        """Start `python arguments` as `name`; `ends`: it may end well by itself."""
        if ends:
            self._ending.add(name)
        with self._log(name).open('ab') as log:
            self._running[name] = subprocess.Popen(
                [sys.executable, *arguments],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                env=self._environment,
                # its own group: Ctrl-C is for us, who end them in order
                start_new_session=True,
                preexec_fn=_end_with_parent,
            )

    def check(self) -> None:
        """Raise ProcessError, with its last words, when one has ended by itself."""
        for name, process in self._running.items():
            status = process.poll()
            if status is not None and not (status == 0 and name in self._ending):
                raise ProcessError(
                    f'{name}: process must keep running, got {_how(status)}\n{self._words(name)}'
                )

    def running(self, name: str) -> bool:
        """Say whether a process has not ended yet."""
        return self._running[name].poll() is None

    def give_up(self, name: str) -> None:
        """Kill a process soon when it is to end: it gets no processor to end in order."""
        self._hopeless.add(name)

    def stop(self, name: str) -> None:
        """End one process: SIGINT, then SIGTERM, then SIGKILL, each with its time."""
        process = self._running.pop(name, None)
        if process is None:
            return
        for number, patience in HURRIED if name in self._hopeless else PATIENCE:
            if process.poll() is not None:
                return
            with suppress(ProcessLookupError):
                process.send_signal(number)
                process.send_signal(signal.SIGCONT)  # a stopped one could not end in order
            with suppress(subprocess.TimeoutExpired):
                process.wait(patience)

    def stop_all(self, order: Sequence[str]) -> None:
        """End all, those of `order` first."""
        for name in [*order, *self._running]:
            self.stop(name)

    def activity(self, name: str) -> Activity | None:
        """Activity of a named process, None for one that has ended."""
        process = self._running.get(name)
        return None if process is None else activity(process.pid)

    def cpu_seconds(self) -> dict[str, float]:
        """Return the processor time each has used so far [s]."""
        found = {name: activity(process.pid) for name, process in self._running.items()}
        return {name: each.cpu for name, each in found.items() if each is not None}

    def _log(self, name: str) -> Path:
        return self._logs / f'{name}.log'

    def _words(self, name: str) -> str:
        lines = self._log(name).read_text(errors='replace').splitlines()
        return '\n'.join(f'  {line}' for line in lines[-LAST_LINES:])


def activity(pid: int) -> Activity | None:
    """Activity of a process from /proc; None where there is none."""
    process = Path(f'/proc/{pid}')
    try:
        threads = list((process / 'task').iterdir())
        runs = any(_stat(thread)[0] == 'R' for thread in threads)
        fields = _stat(process)
        delay = sum(_delay(thread) for thread in threads)
    except (OSError, IndexError):  # it has just ended
        return None
    cpu = (int(fields[11]) + int(fields[12])) / os.sysconf('SC_CLK_TCK')
    return Activity(fields[0] in STOPPED_STATES, runs, cpu, delay)


def _delay(thread: Path) -> float:
    """Return how long a thread has waited for a processor [s]; 0 where the kernel counts none."""
    try:
        return 1e-9 * int((thread / 'schedstat').read_text().split()[1])
    except FileNotFoundError:
        return 0.0


def _stat(folder: Path) -> list[str]:
    """Return the fields of a process or thread behind its name: its state is the first."""
    return (folder / 'stat').read_text().rpartition(')')[2].split()


def free_domain() -> int:
    """Return a ROS domain that no process on this machine uses."""
    start = os.getpid() % len(DOMAINS)
    for domain in (*DOMAINS[start:], *DOMAINS[:start]):
        # the port where the first participant of a domain listens (RTPS 2.2, 9.6.1)
        port = 7410 + 250 * domain
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe, suppress(OSError):
            probe.bind(('', port))
            return int(domain)
    raise ProcessError(f'ROS domain: one of {DOMAINS.start} to {DOMAINS.stop - 1} must be free')


def _how(status: int) -> str:
    return f'exit status {status}' if status >= 0 else f'an end by {signal.Signals(-status).name}'


# loaded before any fork: the child must not allocate
_LIBC = ctypes.CDLL(None)


def _end_with_parent() -> None:
    """Ask the kernel for SIGINT when the parent dies, however it dies."""
    # what a script starts in the background inherits deafness to it
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    _LIBC.prctl(PR_SET_PDEATHSIG, int(signal.SIGINT), 0, 0, 0)


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
    """

    tasks: Tasks  # the processes
    speaker: Speaker  # what nodes say
    real_time: bool = True  # whether loops must meet their deadlines
    # whether a phase is on, in which loops that fall behind spoil what is measured
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
            A process is stopped, hangs or starves; a loop is too late; the recording has ended;
            the plant has diverged.
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
        self.check_plant()
        if failure := self.speaker.failure('recorder: recording'):
            raise ProcessError(f'recorder: recording must go on, got: {failure}')

    def check_plant(self) -> None:
        """Raise ProcessError where the plant has diverged since it was started."""
        if cause := self.speaker.diagnostics('plant: plant').get('divergence'):
            raise ProcessError(f'plant: state must be one that the robot can have, got: {cause}')

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
        if watched.silent > (HUNG if idle else LONGEST_SILENCE):
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
