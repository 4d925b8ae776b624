"""`denoc up` with a shaper between the session's reference and whoever follows it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from denoc_ros.bags.reader import header_stamp_ns, read_bag

pytestmark = pytest.mark.ros
SESSION = """
robot: robots/two_link_ff.urdf
time: real
gravity: [0, -9.81, 0]
reference: {kind: points, times: [0, 0.8], positions: [[0.3, 0.6], [0.7, 0.9]]}
duration: 1
nodes:
  shaper: {method: zvd, update_rate: 250}
  feedforward: false
  predictor: false
plant: {update_rate: 250}
"""


def test_reference_goes_through_the_shaper(tmp_path: Path) -> None:
    file = tmp_path / 'session.yaml'
    file.write_text(SESSION)
    run = tmp_path / 'run'
    command = [sys.executable, '-m', 'denoc_ros.cli.main', 'up', str(file), '--output', str(run)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=240, check=False)
    assert done.returncode == 0, done.stderr
    topics = '/shaper/input', '/reference'
    found = {name: list(read_bag(run / 'bag', [name])) for name in topics}
    (asked,), (told,) = (found[name] for name in topics)
    assert told.log_ns >= asked.log_ns
    # later where the machine was too busy to plan in time
    assert header_stamp_ns(told.message) >= header_stamp_ns(asked.message)
    last = told.message.points[-1]
    np.testing.assert_allclose(last.positions, [0.7, 0.9], atol=1e-6)
    assert last.time_from_start.sec + 1e-9 * last.time_from_start.nanosec > 1.2
    processes = Path('/proc').glob('[0-9]*/cmdline')
    assert not [file for file in processes if str(run).encode() in read(file)]


def read(file: Path) -> bytes:
    try:
        return file.read_bytes()
    except OSError:
        return b''
