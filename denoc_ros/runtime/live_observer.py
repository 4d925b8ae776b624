"""The observer that a predictor's parameters ask for, and its state."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from denoc_ros.dynamics.robot import Robot
from denoc_ros.estimation.fusion import StrainFusion
from denoc_ros.estimation.observer import Observer
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
    known = name in OBSERVER or name == 'joint_state_timeout'
    return known or name.startswith(('fusion.', 'adapt'))


def accepted_values(observer: Observer) -> int:
    """Return how many values of sensors have corrected an observer, of all times."""
    fusion = observer.fusion
    return 0 if fusion is None else sum(counts['accepted'] for counts in fusion.counts)


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
    for unit, is_trusted in zip(faults.units, faults.trusted.tolist(), strict=True):
        status.values[f'{unit.name} trusted'] = 'yes' if is_trusted else 'no'
    if silent:
        status.worsen(WARN, f'no recent value from {", ".join(silent)}: the model goes on alone')
    if refused:
        status.worsen(WARN, f'only late or refused values from {", ".join(refused)}')
    reasons = '; '.join(f'{name}: {cause}' for name, cause in faults.causes.items())
    if faults.uses_joints_only:
        message = 'sensors contradict each other or the joints: the estimate uses the joints alone'
        status.worsen(WARN, f'{message}{f" ({reasons})" if reasons else ""}')
    elif reasons:
        status.worsen(WARN, f'excluded: {reasons}')
    return status
