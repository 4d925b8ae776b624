"""The observer that the parameters of a predictor ask for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields

import numpy as np

from denoc_ros.dynamics.robot import Robot
from denoc_ros.estimation.fusion import FusionSettings
from denoc_ros.estimation.observer import Observer
from denoc_ros.estimation.observer_settings import ObserverSettings
from denoc_ros.runtime.parameters import Settings
from denoc_ros.types import Array

OBSERVER_SETTINGS = (
    'horizon',
    'horizon_steps',
    'cutoff',
    'correction_cutoff',
    'joint_state_timeout',
)
FUSION_SETTINGS = tuple(field.name for field in fields(FusionSettings))


def build_observer(
    robot: Robot, settings: Settings, period: float, joints: Sequence[str], posture: Array
) -> Observer:
    """Return an observer, all that a tick calls of it called once.

    Parameters
    ----------
    robot : Robot
    settings : Settings
        Of a predictor.
    period : float
        Of the loop [s].
    joints : sequence of str
        That are measured.
    posture : (n,) array
        Near which loops are closed.

    Raises
    ------
    StateError, SolverError
        As :class:`Observer`.
    """
    fuse = settings.text('strain') == 'fuse'
    observer = Observer(
        robot,
        ObserverSettings(
            step=period,
            source=settings.text('source'),
            cutoff=settings.number('cutoff'),
            correction_cutoff=settings.number('correction_cutoff'),
            horizon=settings.number('horizon'),
            horizon_steps=settings.integer('horizon_steps'),
            max_age=settings.number('joint_state_timeout'),
            motor_effort=settings.text('effort_source') == 'commanded',
            fusion=FusionSettings(**_fusion(settings)) if fuse else None,
        ),
        joints,
        posture,
    )
    there, still = observer.motion.posture[observer.motion.index], np.zeros(len(joints))
    observer.measure(0.0, there, still, still)
    observer.measure(period, there, still, still)
    # one of each value: what inertial sensors need compiles here
    for place in range(len(observer.fusion.names) if observer.fusion else 0):
        observer.sense(place, period, 0.0)
    observer.tick(2.0 * period)
    count = len(observer.springs.whole.names)
    observer.modal_state((np.empty(count), np.empty(count)))
    observer.predict()
    observer.reset()
    return observer


def is_observers(name: str) -> bool:
    """Say whether a live parameter belongs to the observer or to its tracker of numbers."""
    return name in OBSERVER_SETTINGS or name.startswith(('fusion.', 'adapt'))


def _fusion(settings: Settings) -> dict[str, float]:
    return {name: settings.number(f'fusion.{name}') for name in FUSION_SETTINGS}
