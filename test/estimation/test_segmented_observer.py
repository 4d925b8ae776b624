"""Sensors on a link that bends far mend a wrong model: deflections are not linear there."""

from __future__ import annotations

import numpy as np
import pytest
from segmented_robots import strip_text

import denoc_ros as dn
from denoc_ros.estimation.fusion import FusionSettings
from denoc_ros.estimation.observer import Observer
from denoc_ros.estimation.observer_settings import ObserverSettings
from denoc_ros.simulation.simulate import Run
from denoc_ros.types import Array

STEP = 2e-3
END = 2.0
SENSORS = """<sensor name="tip" type="deflection" link="strip" station="1" direction="y"
noise="1e-3"/><sensor name="middle" type="deflection" link="strip" station="0.5" direction="y"
noise="1e-3"/>"""


def boom(**overrides: float) -> dn.Robot:
    """The strip on a joint about Z, as four segments."""
    text = strip_text(4, mass=0.3, more=SENSORS).replace(
        '"clamp" type="fixed"', '"clamp" type="continuous"'
    )
    text = text.replace(
        '<child link="strip"/></joint>', '<child link="strip"/><axis xyz="0 0 1"/></joint>', 1
    )
    return dn.load_robot(text, gravity=(0, 0, 0)).with_overrides(overrides)


def swing(t: float) -> tuple[float, float, float]:
    """Angle, rate and acceleration of the joint: a swing that begins at rest."""
    w, a = np.pi, 0.9
    return a * (1 - np.cos(w * t)) / 2, a * w * np.sin(w * t) / 2, a * w**2 * np.cos(w * t) / 2


@pytest.fixture(scope='module')
def run() -> Run:
    """What the true boom does: it is softer by a fifth than the observer's."""
    true = boom(**{'beam.strip.y.ei': 0.8})
    zero = np.zeros(true.n)
    return dn.simulate(
        true, zero, zero, np.arange(0.0, END, STEP), prescribed={'clamp': swing}, rtol=1e-6
    )


def estimated(run: Run, fuse: bool) -> Array:
    """Tip deflections (k, 2) that an observer makes of the joint's motion and the sensors."""
    robot = boom()
    found = Observer(robot, ObserverSettings(step=STEP, fusion=FusionSettings() if fuse else None))
    values = robot.sensor_values(run.q)
    values += 1e-3 * np.random.default_rng(3).standard_normal(values.shape)
    tips = []
    for k, t in enumerate(run.t):
        found.measure(t, run.q[k, :1], run.qd[k, :1], run.torque[k, :1])
        for place, value in enumerate(values[k] if fuse else ()):
            found.sense(place, t, float(value))
        found.tick(t)
        tips.append(robot.tip_deflection('strip', found.q)[:2])
    return np.array(tips)


@pytest.mark.long
def test_deflections_mend_a_soft_boom(run: Run) -> None:
    robot = boom()
    true = robot.tip_deflection('strip', run.q)[:, :2]
    peak = np.abs(true[:, 1]).max()
    assert peak > 0.15  # m, of a length of 1 m
    off = {
        fuse: np.sqrt(np.mean((estimated(run, fuse) - true) ** 2, axis=0)) / peak
        for fuse in (True, False)
    }
    assert off[True][1] < 0.01  # of the peak
    assert off[True][0] < 0.01
    assert off[False][1] > 5.0 * off[True][1]
