"""Faults of processes: told to end, killed, started where the kernels' cache cannot be written."""

from __future__ import annotations

import signal
import time

import numpy as np
from trust.outcome import Outcome, judge_torques
from trust.stage import Stage


def told_to_end(stage: Stage) -> Outcome:
    """SIGTERM: the safe command, said again, and nothing more."""
    outcome = Outcome('SIGTERM', 'SIGTERM to the feedforward while it follows, then a new start')
    stage.follow()
    begin = time.time()
    sent = len(stage.commands())
    process = stage.processes.signal('feedforward', signal.SIGTERM)
    took = stage.until(lambda: process.poll() is not None, 10.0, 'the end of the process')
    time.sleep(0.1)
    end = time.time()
    outcome.require(process.returncode == 0, f'exit status must be 0, got {process.returncode}')
    torques = stage.torques(begin, end)
    judge_torques(outcome, torques)
    final = stage.commands()[sent:]
    repeated = int((np.abs(final - final[-1]).max(axis=1) < 1e-9)[::-1].cumprod().sum())
    outcome.require(repeated >= 3, f'the last command must come again, came {repeated} times')
    outcome.require(not torques.following[-1], 'the last torque must be the safe one')
    outcome.torque = f'safe command, the last one sent {repeated} times'
    outcome.diagnostics = f'end after {took:.2f} s with status 0'
    outcome.lost = _again(stage)
    return outcome


def killed(stage: Stage) -> Outcome:
    """SIGKILL: silence, and a restart that needs no cleaning up."""
    outcome = Outcome('SIGKILL', 'SIGKILL to the feedforward while it follows, then a new start')
    stage.follow()
    begin = time.time()
    process = stage.processes.signal('feedforward', signal.SIGKILL)
    process.wait(60.0)
    time.sleep(0.2)
    torques = stage.torques(begin - 0.2, time.time())
    judge_torques(outcome, torques)
    outcome.torque = 'silence: a controller with a time-out of its own has to end it'
    outcome.diagnostics = 'silence'
    outcome.lost = _again(stage)
    return outcome


def unwritable_cache(stage: Stage) -> Outcome:
    """A cache folder that cannot be made: the node starts all the same."""
    outcome = Outcome('cache not writable', 'NUMBA_CACHE_DIR where no folder can be made')
    stage.processes.stop('feedforward')
    begin = time.time()
    with stage.processes.environment(NUMBA_CACHE_DIR='/dev/null/cache'):
        took = stage.start_feedforward()
    judge_torques(outcome, stage.torques(begin, time.time()), silent=True)
    outcome.torque = f'followed {took:.1f} s after the start'
    outcome.diagnostics = 'ok'
    return outcome


def _again(stage: Stage) -> str:
    begin = time.time()
    took = stage.start_feedforward()
    judged = Outcome('', '')
    judge_torques(judged, stage.torques(begin, time.time()))
    assert not judged.broken, judged.broken
    return f'followed {took:.1f} s after a new start, nothing to clean up'
