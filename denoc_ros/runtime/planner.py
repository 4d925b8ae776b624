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

from denoc_ros.control.jobs import read_message, write_message
from denoc_ros.runtime.realtime import SINGLE_THREADED
from denoc_ros.types import Array

ENDING = 1.0  # s that the process has to end by itself
RESTART_AFTER = 1.0  # s between starts of processes that die


@dataclass(frozen=True)
class Answer:
    """The answer of the process to a job: `error` is '' on success."""

    job: int
    error: str
    header: dict[str, Any]
    arrays: dict[str, Array]


class Planner:
    """Starts the process, hands it one job at a time, notices that it is late or dead.

    Nothing here blocks but `close`, for at most `ENDING` s. All methods are one thread's.

    Attributes
    ----------
    starts : int
        How often the process was started.
    deaths : int
        How often it ended by itself.
    """

    def __init__(self) -> None:
        self.starts = 0
        self.deaths = 0
        self._process: subprocess.Popen[bytes] | None = None
        self._answers: deque[Answer] = deque()
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

    def start(self, now: float | None = None) -> bool:
        """Start the process where there is none; say whether there is one."""
        if self._process is not None:
            return True
        now = time.perf_counter() if now is None else now
        if now - self._started < RESTART_AFTER:
            return False
        self._started = now
        self.starts += 1
        command = [sys.executable, '-m', 'denoc_ros.control.planner_process']
        self._process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            bufsize=-1,
            env={**os.environ, **SINGLE_THREADED},  # small matrices: ten times as fast
        )
        threading.Thread(target=self._listen, args=(self._process,), daemon=True).start()
        return True

    def _listen(self, process: subprocess.Popen[bytes]) -> None:
        """Take answers until the process has ended or says what is none."""
        answers = cast(BinaryIO, process.stdout)
        with suppress(OSError, ValueError):
            while (message := read_message(answers)) is not None:
                header, arrays = message
                answer = Answer(int(header['id']), str(header.get('error', '')), header, arrays)
                self._answers.append(answer)
        with suppress(OSError):
            process.kill()

    def submit(self, header: dict[str, Any], arrays: dict[str, Array], limit: float) -> int:
        """Hand over a job that may take `limit` s; return its number.

        The process must have been started and not be busy.
        """
        self._job += 1
        self._pending = self._job
        self._limit = limit
        self._due = time.perf_counter() + limit
        process = self._process
        assert process is not None
        assert process.stdin is not None
        # a process that is still starting reads late, and a pipe holds little
        job = cast(BinaryIO, process.stdin), {**header, 'id': self._job}, arrays
        threading.Thread(target=_write, args=job, daemon=True).start()
        return self._job

    def poll(self) -> Answer | None:
        """Return the answer to the job under way, None while there is none.

        A process that died or is late is ended and taken for an answer with an error.
        """
        while self._answers:
            answer = self._answers.popleft()
            if answer.job == self._pending:
                self._pending = None
                return answer
        process = self._process
        if process is not None and process.poll() is not None and not self._answers:
            self._process = None
            self.deaths += 1
            return self._failed(f'the planner must answer, got its end ({process.returncode})')
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
            self.close(0.0)

    def close(self, patience: float = ENDING) -> None:
        """End the process."""
        self._pending = None
        self._kill(patience)

    def _kill(self, patience: float = 0.0) -> None:
        process, self._process = self._process, None
        if process is None:
            return
        if process.stdin is not None:
            with suppress(OSError):
                process.stdin.close()
        try:
            process.wait(patience)
        except subprocess.TimeoutExpired:
            process.kill()
            with suppress(subprocess.TimeoutExpired):
                process.wait(ENDING)
        self._started = -RESTART_AFTER


def _write(stream: BinaryIO, header: dict[str, Any], arrays: dict[str, Array]) -> None:
    """Write a job; a process that has died or been ended meanwhile is found out by `poll`."""
    with suppress(OSError, ValueError):
        write_message(stream, header, arrays)
