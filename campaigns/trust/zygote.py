"""Starts node processes fast: a process that has imported everything forks one for each start.

`python -m trust.zygote URDF` reads starts as lines of JSON (`node`, `arguments`, `log`) and
prints `started PID` and, when one has ended, `ended PID STATUS`. It forks before anything of ROS
exists in the process; from there on the node lives and ends as any other.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

NODES = ('feedforward', 'predictor', 'plant', 'recorder', 'viewer', 'shaper')


class Child:
    """A forked process, as subprocess.Popen has it."""

    def __init__(self, pid: int) -> None:
        self.pid = pid
        self.returncode: int | None = None

    def poll(self) -> int | None:
        return self.returncode

    def send_signal(self, number: int) -> None:
        if self.returncode is None:
            os.kill(self.pid, number)


class Zygote:
    """The forking process, seen from outside."""

    def __init__(self, urdf: Path, environment: Mapping[str, str]) -> None:
        self._process = subprocess.Popen(
            [sys.executable, '-m', 'trust.zygote', str(urdf)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env={**os.environ, **environment},
            text=True,
        )
        self._children: dict[int, Child] = {}
        self._started: list[Child] = []
        threading.Thread(target=self._read, daemon=True).start()

    def start(self, node: str, arguments: Sequence[str], log: Path) -> Child:
        count = len(self._started)
        assert self._process.stdin is not None
        line = json.dumps({'node': node, 'arguments': list(arguments), 'log': str(log)})
        self._process.stdin.write(line + '\n')
        self._process.stdin.flush()
        end = time.monotonic() + 240.0
        while len(self._started) == count:
            assert time.monotonic() < end, 'a start must come about in time'
            assert self._process.poll() is None, 'what forks must go on'
            time.sleep(0.002)
        return self._started[-1]

    def _read(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            kind, *numbers = line.split()
            if kind == 'started':
                self._children[int(numbers[0])] = Child(int(numbers[0]))
                self._started.append(self._children[int(numbers[0])])
            elif kind == 'ended':
                self._children.pop(int(numbers[0])).returncode = int(numbers[1])

    def close(self) -> None:
        for child in list(self._children.values()):
            child.send_signal(signal.SIGKILL)
        assert self._process.stdin is not None
        self._process.stdin.close()
        self._process.wait(10.0)


def main() -> None:
    import denoc_ros as dn
    from denoc_ros.nodes import feedforward, plant, predictor, recorder
    from denoc_ros.planning import shaper
    from denoc_ros.runtime.loop.ending import SIGNALS
    from denoc_ros.viewer import page, viewer

    assert page is not None
    modules = dict(
        zip(NODES, (feedforward, predictor, plant, recorder, viewer, shaper), strict=True)
    )
    dn.load_robot(Path(sys.argv[1]))  # and its kernels
    say = threading.Lock()

    def tell(*words: object) -> None:
        with say:
            print(*words, flush=True)

    def reap(pid: int) -> None:
        _, status = os.waitpid(pid, 0)
        tell('ended', pid, os.waitstatus_to_exitcode(status))

    for line in iter(sys.stdin.readline, ''):
        start = json.loads(line)
        with say:
            pid = os.fork()
        if pid == 0:
            SIGNALS.end_at_once()
            log = os.open(start['log'], os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o600)
            for stream in (1, 2):
                os.dup2(log, stream)
            os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
            sys.argv = [start['node'], *start['arguments']]
            print(f'{start["node"]}: starting', flush=True)
            modules[start['node']].main()
            os._exit(99)
        tell('started', pid)
        threading.Thread(target=reap, args=(pid,), daemon=True).start()


if __name__ == '__main__':
    main()
