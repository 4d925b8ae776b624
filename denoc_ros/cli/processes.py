"""The processes of a session: started, watched, ended in order and within bounds."""

from __future__ import annotations

import ctypes
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from denoc_ros.errors import DenocError

LAST_LINES = 12  # of a dead process's output that the error shows
# s: how long a process may take to answer each signal before the next, harder one
PATIENCE = ((signal.SIGINT, 30.0), (signal.SIGTERM, 3.0), (signal.SIGKILL, 3.0))
HURRIED = ((signal.SIGINT, 3.0), (signal.SIGKILL, 3.0))  # for one that gets no processor
DOMAINS = range(1, 101)  # above 101 the ports would meet the ephemeral ones
PR_SET_PDEATHSIG = 1
STOPPED_STATES = 'Tt'  # of /proc: by a signal, by a debugger


class ProcessError(DenocError):
    """A process of the session ended when it should not have."""


class Activity(NamedTuple):
    """Activity of a process.

    Attributes
    ----------
    stopped : bool
        By SIGSTOP or a debugger.
    runs : bool
        Whether a thread runs or wants a processor; otherwise all wait for something.
    cpu : float
        Processor time that it has used [s].
    delay : float
        How long its threads have waited for a processor, all together [s].
    """

    stopped: bool
    runs: bool
    cpu: float
    delay: float = 0.0


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
        self._environment = {**os.environ, **environment, 'PYTHONUNBUFFERED': '1'}
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
    """Return a ROS domain that no process on this machine uses.

    Raises
    ------
    ProcessError
        When all are taken.
    """
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
