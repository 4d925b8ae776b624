"""The observer on a mechanism: passive joints come from the loop, amplitudes from the motion."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest

import denoc_ros as dn
from denoc_ros.dynamics.driven.torque_feedforward import TorqueFeedforward
from denoc_ros.estimation.fusion import FusionSettings
from denoc_ros.estimation.observer import Observer
from denoc_ros.estimation.observer_settings import ObserverSettings
from denoc_ros.trajectories import SineTrajectory
from denoc_ros.types import Array

ROBOT = Path(__file__).resolve().parents[2] / 'config' / 'robots' / 'five_bar_ffff.urdf'
DRIVEN = ('joint_1', 'joint_3')
START = np.radians([108.0, 72.0])
STEP = 1e-3
GAUGE = """<sensor name="gauge" type="strain_gauge" link="link_2" station="0.5" direction="y"
surface="0.01" noise="1e-8"/></flexibility>"""


def load(**overrides: float) -> tuple[dn.Robot, Array]:
    """The five-bar with damping, soft enough to be seen bending, and its posture."""
    text = ROBOT.read_text().replace('</flexibility>', GAUGE)
    text = text.replace('ei="1570.7963267949"', 'ei="300"').replace('ratio="0"', 'ratio="0.02"')
    robot = dn.load_robot(text, gravity=(0, -9.81, 0))
    if overrides:
        robot = robot.with_overrides({k.replace('__', '.'): v for k, v in overrides.items()})
    posture = np.zeros(robot.n)
    posture[robot.joint_indices] = np.radians([108.0, -72.0, 72.0, 72.0])
    return robot, robot.assemble(posture)


@cache
def run() -> tuple[Array, Array, Array]:
    """Driven joints swing for a second: states (k, n), rates, and the torque that took."""
    robot, posture = load()
    motion = SineTrajectory(
        START, np.full(2, 0.3), np.full(2, 1.5), np.zeros(2), duration=1.0, ramp=0.3
    )
    feedforward = TorqueFeedforward(robot, DRIVEN, posture=posture, step=STEP)
    rows: list[Array] = []
    wanted, rate, acceleration = np.zeros((3, 2))
    for k in range(1000):
        motion.sample(STEP * k, wanted, rate, acceleration)
        torque = feedforward.update(wanted, rate, acceleration, STEP if k else 0.0)
        rows.append(np.concatenate((feedforward.q, feedforward.qd, torque)))
    table = np.array(rows)
    n = robot.n
    return table[:, :n], table[:, n : 2 * n], table[:, 2 * n :]


def watch(source: str, fuse: bool = False, **overrides: float) -> tuple[Observer, Array]:
    """Let an observer see the driven joints; return it and its states (k, n)."""
    robot, posture = load(**overrides)
    q, qd, torque = run()
    fusion = FusionSettings() if fuse else None
    settings = ObserverSettings(STEP, source, cutoff=200.0, fusion=fusion)
    found = Observer(robot, settings, DRIVEN, posture)
    places = found.motion.index
    rows = []
    for k in range(len(q)):
        found.measure(STEP * k, q[k, places], qd[k, places], torque[k])
        if fuse:
            found.sense(0, STEP * k, float(robot.sensor_values(q[k])[0]))
        found.tick(STEP * k)
        rows.append(found.q.copy())
    return found, np.array(rows)


def miss(robot: dn.Robot, states: Array) -> float:
    """Return the rms error of all amplitudes as a share of their peak, after the start."""
    flexible = robot.flexible_indices
    true = run()[0][100:, flexible]
    return float(np.sqrt(np.mean((states[100:, flexible] - true) ** 2)) / np.abs(true).max())


# joints' motion by a filter of 200 Hz, 1.5 Hz fast: 1 %; joints pulled to what is measured at
# 10 Hz, torques held over a step: as much again
@pytest.mark.parametrize(('source', 'most'), [('joints', 0.03), ('torque', 0.05)])
def test_amplitudes_of_a_mechanism_are_estimated(source: str, most: float) -> None:
    found, states = watch(source)
    assert miss(found.robot, states) < most
    assert np.abs(found.robot.closure(states)).max() < 1e-9
    np.testing.assert_allclose(states[500, [0, 3, 6, 9]], run()[0][500, [0, 3, 6, 9]], atol=2e-3)


def test_a_gauge_mends_a_wrong_stiffness_in_a_mechanism() -> None:
    _, alone = watch('joints', beam__link_2__y__ei=240.0)
    fused, with_gauge = watch('joints', fuse=True, beam__link_2__y__ei=240.0)
    place = fused.robot.amplitudes('link_2').start
    true = run()[0][300:, place]
    errors = [np.sqrt(np.mean((q[300:, place] - true) ** 2)) for q in (alone, with_gauge)]
    assert errors[1] < 0.3 * errors[0]
    assert fused.fusion is not None
    assert fused.fusion.counts[0]['accepted'] > 900
