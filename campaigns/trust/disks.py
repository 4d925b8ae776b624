"""Faults of the disk behind a recorder, while the feedforward's loop goes on beside it."""

from __future__ import annotations

import signal
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from trust.outcome import Outcome, judge_torques
from trust.stage import PATIENCE, Stage

from denoc_ros.bags.reader import read_bag
from denoc_ros.bags.recover import recover
from denoc_ros.cli.session.node_parameters import write_parameters

TOPICS = ['/joint_states', '/feedforward/effort']
FLUSH = 0.2  # s
DELIVERY = 0.3  # s from a publisher to the recorder's file on a loaded machine, beyond the flush
NAME = 'recorder: recording'

# a file size limit refuses as a full disk does, and needs no privilege; on a busy machine a chunk
# holds what came in seconds, so that much less would leave room for none
ROOM = 600_000  # bytes: some three seconds
FULL = f"""
import resource, sys
resource.setrlimit(resource.RLIMIT_FSIZE, ({ROOM}, {ROOM}))
from denoc_ros.nodes.recorder import main
sys.exit(main())
"""
SLOW = """
import sys, time
from denoc_ros.bags.storage import DiskFile
write = DiskFile.write
def slow_write(disk, block):
    time.sleep(0.2)
    return write(disk, block)
DiskFile.write = slow_write
from denoc_ros.nodes.recorder import main
sys.exit(main())
"""
GOOD = 'import sys; from denoc_ros.nodes.recorder import main; sys.exit(main())'


class Recording:
    """A recorder process that a script of its own starts."""

    def __init__(self, stage: Stage, name: str, script: str, **more: Any) -> None:
        self.stage, self.bag = stage, stage.folder / name
        file = stage.folder / f'{name}.yaml'
        given = {'output': str(self.bag), 'topics': TOPICS, 'flush_period': FLUSH, **more}
        write_parameters(file, given)
        self.begin = time.time()
        arguments = ['-c', script, '--ros-args', '--params-file', str(file)]
        stage.processes.start('recorder', arguments)
        stage.until(self._records, PATIENCE, 'recorder: all its topics')

    def _records(self) -> bool:
        return self.value('topics') == str(len(TOPICS)) or self.level() == 2

    def statuses(self) -> list[tuple[Any, Mapping[str, str]]]:
        """Return what it has said: the last words of a recorder before it may come late."""
        found = self.stage.statuses(NAME, self.begin)
        said = [(status, {v.key: v.value for v in status.values}) for status in found]
        return [(status, values) for status, values in said if values.get('path') == str(self.bag)]

    def value(self, key: str) -> str:
        found = self.statuses()
        return found[-1][1].get(key, '') if found else ''

    def level(self) -> int:
        found = self.statuses()
        return int.from_bytes(found[-1][0].level, 'little') if found else 0

    def said(self) -> str:
        """Return the worst that it has said on /diagnostics."""
        worst, _ = max(self.statuses(), key=lambda said: said[0].level)
        return str(worst.message).replace(str(self.stage.folder), '.')

    def end(self, number: int = signal.SIGTERM) -> int:
        """Send a signal; return the exit status."""
        process = self.stage.processes.signal('recorder', number)
        self.stage.until(lambda: process.poll() is not None, PATIENCE, 'the end of the recorder')
        return int(process.returncode)

    def kept(self, path: Path) -> int:
        return len(list(read_bag(path)))


def _around(stage: Stage, outcome: Outcome, begin: float) -> None:
    torques = stage.torques(begin, time.time())
    judge_torques(outcome, torques)
    share = float(torques.following.mean())
    # a node that joins may stop the others for longer than the time-out of the joint states
    outcome.require(share > 0.5, f'the loop must go on following, did in {100 * share:.0f} %')
    outcome.torque = f'followed in {100 * share:.0f} % of {len(torques.effort)} messages'


def full_disk(stage: Stage) -> Outcome:
    outcome = Outcome('full disk', f'no byte beyond {ROOM // 1000} kB in the file (RLIMIT_FSIZE)')
    stage.follow()
    begin = time.time()
    recording = Recording(stage, 'full', FULL, compression='none')
    stage.until(lambda: recording.level() == 2, PATIENCE, 'an error on /diagnostics')
    status = recording.end()
    kept = recording.kept(recording.bag)
    outcome.require(status == 0, f'exit status must be 0, got {status}')
    outcome.require(kept > 50, f'the bag must be whole, has {kept} messages')
    _around(stage, outcome, begin)
    outcome.diagnostics = recording.said()
    outcome.lost = f'what came after; {kept} messages in a whole bag'
    return outcome


def slow_disk(stage: Stage) -> Outcome:
    outcome = Outcome('slow disk', 'each write takes 0.2 s; room for 50 messages in the queue')
    stage.follow()
    begin = time.time()
    recording = Recording(stage, 'slow', SLOW, queue_size=50)
    stage.until(lambda: int(recording.value('lost') or 0) > 0, PATIENCE, 'losses on /diagnostics')
    outcome.diagnostics = recording.said()
    outcome.require(recording.end() == 0, 'exit status must be 0')
    kept = recording.kept(recording.bag)
    log = (stage.folder / 'logs' / 'recorder.log').read_text()
    outcome.require(f'{kept} messages on' in log, 'what was written must be counted exactly')
    _around(stage, outcome, begin)
    outcome.lost = log.rstrip().rpartition(': ')[2]
    return outcome


def killed_recorder(stage: Stage) -> Outcome:
    outcome = Outcome('recorder killed', 'SIGKILL to the recorder, `denoc recover`')
    stage.follow()
    begin = time.time()
    recording = Recording(stage, 'killed', GOOD)
    time.sleep(1.0)
    now = time.time_ns()
    recording.end(signal.SIGKILL)
    found = recover(recording.bag)
    last = max(item.log_ns for item in read_bag(found.path))
    missing = 1e-9 * (now - last)
    law = f'at most {FLUSH} s may be lost'
    outcome.require(missing < FLUSH + DELIVERY, f'{law}, {missing:.2f} s are')
    _around(stage, outcome, begin)
    outcome.diagnostics = 'silence'
    outcome.lost = f'the last {1e3 * max(missing, 0.0):.0f} ms of {found.messages} messages'
    return outcome


def short_disk(stage: Stage) -> Outcome:
    outcome = Outcome('short of room', 'less room than `min_free_space` from the start')
    stage.follow()
    begin = time.time()
    recording = Recording(stage, 'short', GOOD, min_free_space=1 << 60)
    stage.until(lambda: recording.level() == 2, PATIENCE, 'an error on /diagnostics')
    outcome.require(recording.end() == 0, 'exit status must be 0')
    kept = recording.kept(recording.bag)
    _around(stage, outcome, begin)
    outcome.diagnostics = recording.said()
    outcome.lost = f'all but {kept} messages, in a whole bag'
    return outcome
