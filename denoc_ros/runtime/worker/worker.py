"""The parent's side of the planning process."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time
from collections import deque
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, BinaryIO, cast

from denoc_ros.python_start import code_words
from denoc_ros.runtime.loop.realtime import SINGLE_THREADED
from denoc_ros.runtime.worker.worker_messages import read_message, write_message
from denoc_ros.types import Array

ENDING = 1.0  # s within which a killed process is gone, unless its disk hangs
LOOK = 0.02  # s between looks whether it is
RESTART_AFTER = 1.0  # s between starts of processes that die
# modules stay: to look for garbage among them takes an eighth of a start
CHILD = (
    'import gc; gc.disable(); from denoc_ros.runtime.worker.worker_process import main; '
    'gc.freeze(); gc.enable(); main()'
)
# a process that is stopped before its exec would hold all threads of its parent
subprocess._USE_VFORK = False  # type: ignore[attr-defined]


@dataclass(frozen=True)
class Answer:
    """The answer of the process to a job: `error` is '' on success."""

    job: int
    error: str
    header: dict[str, Any]
    arrays: dict[str, Array]


class ChildProcess:
    """One process from its start to its end, in the hands of a thread: nobody else waits for it.

    It may be stopped at any moment, even between fork and exec, where its parent waits for it:
    with vfork the whole interpreter would, with fork it is the thread alone.

    Attributes
    ----------
    answers : deque of Answer
        Those not taken yet.
    over : threading.Event
        Set when the process has ended, or could not be started.
    failure : str
        How it ended.
    """

    def __init__(self) -> None:
        self.answers: deque[Answer] = deque()
        self.over = threading.Event()
        self.failure = ''
        self._popen: subprocess.Popen[bytes] | None = None
        self._ready = threading.Event()
        self._unwanted = False

    def start(self) -> None:
        """Start the thread, and in it the process."""
        threading.Thread(target=self._live, daemon=True).start()

    @property
    def pid(self) -> int | None:
        """Of the process, None before it is there."""
        return getattr(self._popen, 'pid', None)

    def _live(self) -> None:
        """Start the process, take its answers until there are no more, and see it end."""
        try:
            process = self._started()
        except OSError as error:
            self.failure = str(error)
            self.over.set()
            return
        finally:
            self._ready.set()
        if self._unwanted:
            process.kill()
        answers = cast(BinaryIO, process.stdout)
        with suppress(OSError, ValueError):
            while (message := read_message(answers)) is not None:
                header, arrays = message
                answer = Answer(int(header['id']), str(header.get('error', '')), header, arrays)
                self.answers.append(answer)
        process.kill()
        self.failure = str(process.wait())
        self.over.set()
        for stream in (answers, cast(BinaryIO, process.stdin)):
            with suppress(OSError):
                stream.close()

    def _started(self) -> subprocess.Popen[bytes]:
        child = self

        class Known(subprocess.Popen[bytes]):
            """Can be killed while it is being made."""

            def __init__(self, *given: Any, **options: Any) -> None:
                child._popen = self
                super().__init__(*given, **options)

        return Known(
            [sys.executable, *code_words(CHILD)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            bufsize=-1,
            # small matrices: ten times as fast
            env={**os.environ, **SINGLE_THREADED},
        )

    def write(self, header: dict[str, Any], arrays: dict[str, Array]) -> None:
        """Write a job in a thread: who still starts reads late, and a pipe holds little."""

        def write() -> None:
            self._ready.wait()
            process = self._popen
            with suppress(OSError, ValueError):  # one that has ended is found out by `over`
                if process is not None and process.stdin is not None:
                    write_message(cast(BinaryIO, process.stdin), header, arrays)

        threading.Thread(target=write, daemon=True).start()

    def kill(self) -> None:
        """End the process: at once, or as soon as it is there."""
        self._unwanted = True
        process = self._popen
        if process is not None and self.pid is not None:
            process.kill()


class Planner:
    """Starts the process, hands it one job at a time, notices that it is late or dead.

    Nothing here waits for the process, which may be stopped at any moment, but `close`: at most
    `ENDING` s for one that has been killed. All methods are one thread's.
    """

    def __init__(self) -> None:
        self.starts = 0
        self.deaths = 0
        self._process: ChildProcess | None = None
        self._job = 0
        self._pending: int | None = None
        self._due = 0.0
        self._limit = 0.0
        self._started = -RESTART_AFTER

    @property
    def busy(self) -> bool:
        """Whether a job is under way."""
        return self._pending is not None

    @property
    def pid(self) -> int | None:
        """Of the process, None while there is none."""
        return self._process.pid if self._process is not None else None

    @property
    def running(self) -> bool:
        """Whether there is a process, or soon will be."""
        return self._process is not None

    def start(self, now: float | None = None) -> bool:
        """Start the process where there is none; say whether there is one."""
        if self._process is not None:
            return True
        now = time.perf_counter() if now is None else now
        if now - self._started < RESTART_AFTER:
            return False
        self._started = now
        self.starts += 1
        self._process = ChildProcess()  # known before it starts: an interrupt leaves none behind
        self._process.start()
        return True

    def submit(self, header: dict[str, Any], arrays: dict[str, Array], limit: float) -> int:
        """Hand over a job that may take `limit` s; return its number.

        The process must have been started and not be busy.
        """
        assert self._process is not None
        self._job += 1
        self._pending = self._job
        self._limit = limit
        self._due = time.perf_counter() + limit
        self._process.write({**header, 'id': self._job}, arrays)
        return self._job

    def poll(self) -> Answer | None:
        """Return the answer to the job under way, None while there is none.

        A process that died or is late is ended and taken for an answer with an error.
        """
        process = self._process
        if process is None:
            return None
        over = process.over.is_set()  # looked at first: no answer comes after it
        while process.answers:
            answer = process.answers.popleft()
            if answer.job == self._pending:
                self._pending = None
                return answer
        if over:
            self._process = None
            self.deaths += 1
            return self._failed(f'the planner must answer, got its end ({process.failure})')
        if self._pending is not None and time.perf_counter() > self._due:
            self._kill()
            return self._failed(f'planning must take at most {self._limit:g} s, got longer')
        return None

    def _failed(self, why: str) -> Answer | None:
        job, self._pending = self._pending, None
        return None if job is None else Answer(job, why, {}, {})

    def drop(self) -> None:
        """Discard the job under way and its answer: the next job does not wait for it."""
        if self._pending is not None:
            self._pending = None
            self._kill()

    def close(self) -> None:
        """End the process, and see that it is gone."""
        self._pending = None
        process = self._kill()
        end = time.perf_counter() + ENDING
        while process is not None and not process.over.wait(LOOK):
            process.kill()  # again: it may have been on its way into the world
            if time.perf_counter() > end:
                return

    def _kill(self) -> ChildProcess | None:
        process, self._process = self._process, None
        self._started = -RESTART_AFTER
        if process is not None:
            process.kill()
        return process
