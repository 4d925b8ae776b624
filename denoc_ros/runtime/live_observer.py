"""The observer that a predictor's parameters ask for, and its state."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from denoc_ros.dynamics.robot import Robot
from denoc_ros.estimation.fusion import StrainFusion
from denoc_ros.estimation.observer import Observer
from denoc_ros.estimation.sensor_faults import SensorFaults
from denoc_ros.runtime.loop.status import WARN, Status
from denoc_ros.runtime.parameters.parameter_table import Settings
from denoc_ros.runtime.parameters.predictor_parameters import FUSION, OBSERVER
from denoc_ros.types import Array

SENSOR_SILENCE = 0.5  # s without a value after which a fused sensor counts as missing


def build_observer(
    robot: Robot, settings: Settings, period: float, joints: Sequence[str], posture: Array
) -> Observer:
    """Return an observer, all that a tick calls of it called once.

    Parameters
    ----------
    period : float
        Of the loop [s].
    """
    fuse = settings.text('strain') == 'fuse'
    observer = Observer(
        robot,
        OBSERVER.read(
            settings,
            step=period,
            source=settings.text('source'),
            max_age=settings.number('joint_state_timeout'),
            motor_effort=settings.text('effort_source') == 'commanded',
            fusion=FUSION.read(settings) if fuse else None,
        ),
        joints,
        posture,
    )
    observer.rehearse()
    return observer


def is_observers(name: str) -> bool:
    """Say whether a live parameter belongs to the observer or to its tracker of numbers."""
    known = name in OBSERVER or name == 'joint_state_timeout'
    return known or name.startswith(('fusion.', 'adapt'))


def accepted_values(observer: Observer) -> int:
    """Return how many values of sensors have corrected an observer, of all times."""
    fusion = observer.fusion
    return 0 if fusion is None else sum(counts['accepted'] for counts in fusion.counts)


def trusted_sensors(faults: SensorFaults) -> dict[str, str]:
    """Say of each sensor whether it is trusted, as diagnostics do."""
    trusted = zip(faults.units, faults.trusted.tolist(), strict=True)
    return {f'{unit.name} trusted': 'yes' if good else 'no' for unit, good in trusted}


def fusion_status(fusion: StrainFusion, now: float) -> Status:
    """Excluded sensors, and counts of each sensor's values by fate."""
    faults = fusion.faults
    status = Status('fusion', message='fusing')
    silent, refused = [], []
    rows = zip(fusion.names, fusion.counts, fusion.heard, fusion.used, strict=True)
    for place, (name, counts, heard, used) in enumerate(rows):
        age = now - heard
        status.values[f'{name} age_s'] = 'never' if np.isnan(age) else float(age)
        for cause, count in sorted(counts.items()):
            status.values[f'{name} {cause}'] = count
        if not age < SENSOR_SILENCE:
            silent.append(name)
        elif faults.uses(place) and not now - used < SENSOR_SILENCE:
            refused.append(name)
    status.values |= trusted_sensors(faults)
    if silent:
        status.worsen(WARN, f'no recent value from {", ".join(silent)}: the model goes on alone')
    if refused:
        status.worsen(WARN, f'only late or refused values from {", ".join(refused)}')
    if faults.finding:
        status.worsen(WARN, faults.finding)
    return status
