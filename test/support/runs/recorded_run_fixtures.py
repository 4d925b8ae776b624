"""A recorded run whose numbers are known: two phases, two joints, one flexible link."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from denoc_ros.bags.writer import BagWriter

START_NS = 1_700_000_000_000_000_000
JOINTS = ['j1', 'j2']
JOINT_STATE = 'sensor_msgs/msg/JointState'
TOPICS = {
    '/up/phase': 'std_msgs/msg/String',
    '/reference': 'trajectory_msgs/msg/JointTrajectory',
    '/joint_states': JOINT_STATE,
    '/feedforward/effort': JOINT_STATE,
    '/predictor/tip_deflection': JOINT_STATE,
    '/plant/true_deflection': JOINT_STATE,
    '/diagnostics': 'diagnostic_msgs/msg/DiagnosticArray',
}
# Amplitude of the tracking error of each phase [rad], of the true deflection [m], and the share
# of it that the prediction misses.
TRACKING = {'rigid': 0.02, 'flexible': 0.001}
DEFLECTION = 0.05
MISSED = 0.1


def wave(t: float) -> float:
    return float(np.sin(2.0 * np.pi * t))


def write_phase(bag: BagWriter, name: str, begin: float, seconds: float, rate: float) -> None:
    def at(t: float) -> int:
        return START_NS + round((begin + t) * 1e9)

    bag.write_message('/up/phase', at(0.0), data=name)
    bag.write_message('/reference', at(0.0), joint_names=JOINTS, points=list(points(seconds)))
    for t in np.arange(0.0, seconds, 1.0 / rate):
        reference = np.array([0.3 * t, 0.1 * t * t])
        measured = reference - TRACKING[name] * wave(t)
        true = DEFLECTION * wave(t)
        bag.write_message('/joint_states', at(t), name=JOINTS, position=measured)
        bag.write_message('/feedforward/effort', at(t), name=JOINTS, effort=[3.0 * wave(t), 1.0])
        for topic, value in (
            ('/plant/true_deflection', true),
            ('/predictor/tip_deflection', true * (1.0 - MISSED)),
        ):
            names = ['arm/ux', 'arm/uy', 'arm/uz']
            bag.write_message(topic, at(t), name=names, position=[-0.5 * value**2, value, 0.0])
    counted = [loop_status('feedforward', 1 + round(begin + seconds))]
    bag.write_message('/diagnostics', at(seconds), status=counted)
    bag.write_message('/up/phase', at(seconds), data='')


def points(seconds: float) -> list[dict[str, object]]:
    rows: list[dict[str, object]] = []
    for t in np.arange(0.0, seconds + 0.05, 0.1):
        nanoseconds = round(t * 1e9)
        since = {'sec': nanoseconds // 10**9, 'nanosec': nanoseconds % 10**9}
        rows.append(
            {
                'positions': [0.3 * t, 0.1 * t * t],
                'velocities': [0.3, 0.2 * t],
                'time_from_start': since,
            }
        )
    return rows


def loop_status(node: str, factor: int) -> dict[str, object]:
    """Return a loop's status with its totals after `factor` equal stretches of time."""
    histogram = [0, 20, 1900, 60, 10, 9, 1]
    values = {
        'nominal_rate_hz': 1000,
        'period_p50_us': 1000,
        'period_p99_us': 1300,
        'period_max_us': 5200,
        'ticks': 2000 * factor,
        'overruns_total': 10 * factor,
        'skipped_total': factor,
        'histogram_edges': '0 0.5 0.9 1.1 1.5 2 10',
        'histogram_counts': ' '.join(str(count * factor) for count in histogram),
    }
    pairs = [{'key': key, 'value': str(value)} for key, value in values.items()]
    return {'name': f'{node}: loop', 'message': 'ok', 'values': pairs}


@pytest.fixture
def recorded_run(tmp_path: Path) -> Callable[[float, float], Path]:
    """Return a maker of runs: seconds per phase and rate [Hz] give the run's directory."""

    def make(seconds: float = 2.0, rate: float = 100.0) -> Path:
        run = tmp_path / 'run'
        run.mkdir()
        with BagWriter(run / 'bag') as bag:
            for topic, kind in TOPICS.items():
                bag.add_topic(topic, kind)
            # what the loop counted before the first phase is not of the run
            bag.write_message(
                '/diagnostics', START_NS - 10**8, status=[loop_status('feedforward', 1)]
            )
            for k, name in enumerate(TRACKING):
                write_phase(bag, name, k * (seconds + 1.0), seconds, rate)
        return run

    return make
