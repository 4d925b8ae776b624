"""The observer and the tracked numbers that a predictor's parameters ask for, and their state."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import ConfigError
from denoc_ros.estimation.fusion import StrainFusion
from denoc_ros.estimation.observer import Observer
from denoc_ros.estimation.parameter_tracker import NOTHING_HEARD, ParameterTracker
from denoc_ros.estimation.sensor_faults import SensorFaults
from denoc_ros.estimation.tracked_model import BaseAt
from denoc_ros.estimation.tracker_settings import tracked_paths
from denoc_ros.runtime.parameters import Settings
from denoc_ros.runtime.predictor_parameters import FUSION, OBSERVER, TRACKER
from denoc_ros.runtime.status import WARN, Status
from denoc_ros.types import Array

LONGEST_LAG = 0.1  # s that sensors' values may come late
AT_BOUND = 1e-3  # share of the width of the bounds: nearer counts as there
Bounds = dict[str, tuple[float, float]]
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


class Adaptation:
    """Tracks the numbers that the parameters `adapt*` of a node name; without one does nothing.

    Parameters
    ----------
    base : callable, optional
        Motion of the base at a time; None: it is at rest.

    Attributes
    ----------
    fresh : bool
        Whether there is something new to publish since the last `apply`.

    Raises
    ------
    ConfigError
        Paths, bounds or a robot that cannot be tracked.
    """

    def __init__(
        self,
        robot: Robot,
        joints: Sequence[str],
        settings: Settings,
        where: str,
        base: BaseAt | None = None,
    ) -> None:
        self.tracker: ParameterTracker | None = None
        self._applied: Array = np.zeros(0)
        self._told, self.fresh = -1, False
        patterns = settings.texts('adapt')
        if not patterns:
            return
        try:
            paths = tracked_paths(robot, patterns)
            lag = min(settings.number('joint_state_timeout'), LONGEST_LAG)
            tuned = TRACKER.read(settings, lag=lag)
            how = robot, paths, tuned, _bounds(settings, paths), joints
            _rehearse(ParameterTracker(*how), len(joints), len(robot.tree.sensors))
            self.tracker = ParameterTracker(*how)
        except ConfigError as error:
            findings = [f"parameter 'adapt': {finding}" for finding in error.findings]
            raise ConfigError(where, findings) from error
        self.tracker.base = base
        self._applied = self.tracker.start.copy()

    def adopt(self, other: Adaptation) -> None:
        """Go on from another's values, if they are of the same numbers and start."""
        if self.tracker is not None and other.tracker is not None:
            self.tracker.adopt(other.tracker)

    def sense(self, place: int, stamp: float, value: float) -> None:
        """Take a sensor's calibrated value, of a time [s]."""
        if self.tracker is not None:
            self.tracker.sense(place, stamp, value)

    def measure(self, stamp: float, q: Array, qd: Array | None, effort: Array | None) -> None:
        """Take the joints (joints,) at a time [s]; None stands for unknown values."""
        if self.tracker is not None:
            self.tracker.measure(stamp, q, qd, effort)

    def reset(self, values: bool) -> None:
        """Forget the measurements, and with `values` also the found numbers."""
        if self.tracker is not None:
            (self.tracker.restart if values else self.tracker.reset)()

    def apply(self, observer: Observer) -> None:
        """Give the present values to an observer that was built with those of the start."""
        tracker = self.tracker
        if tracker is None:
            return
        change = tracker.values - self._applied
        if change.any():
            observer.retune(lambda robot: tracker.numbers.set(robot, change))
            self._applied = tracker.values.copy()
        self.fresh = tracker.blocks != self._told
        self._told = tracker.blocks

    def status(self) -> Status | None:
        """Return the status of the tracking; None if nothing is tracked."""
        tracker = self.tracker
        if tracker is None:
            return None
        values, deviations = tracker.values.copy(), tracker.deviations
        supported, bounds = tracker.supported, tracker.bounds
        frozen = f'no value changes: {tracker.cause}' if tracker.cause else 'tracking'
        status = Status('adaptation', message=frozen)
        ends = []
        for k, path in enumerate(tracker.paths):
            status.values[path] = float(values[k])
            status.values[f'{path} deviation'] = float(deviations[k])
            status.values[f'{path} supported'] = 'yes' if supported[k] else 'no'
            room = AT_BOUND * float(bounds[k, 1] - bounds[k, 0])
            if values[k] < bounds[k, 0] + room or values[k] > bounds[k, 1] - room:
                ends.append(path)
        status.values |= {
            'cause': tracker.cause,
            'model_error': float(tracker.model_error),
            'blocks': tracker.blocks,
            'restarts': tracker.restarts,
            'model_failures': tracker.failures,
        }
        if tracker.cause == NOTHING_HEARD:
            status.worsen(WARN, f'no value changes: {NOTHING_HEARD}')
        if ends:
            status.worsen(WARN, f'at the end of its bounds: {", ".join(ends)}')
        return status


def _rehearse(tracker: ParameterTracker, joints: int, sensors: int) -> None:
    """Run all of a tracker once, so that nothing compiles in a loop."""
    still, settings = np.zeros(joints), tracker.settings
    count = round(2.0 * (settings.lag + settings.block) / settings.step)
    for k in range(count):
        for place in range(sensors):
            tracker.sense(place, k * settings.step, 0.0)
        tracker.measure(k * settings.step, still, still, still)


def _bounds(settings: Settings, paths: Sequence[str]) -> Bounds:
    """Return the bounds by path of pairs in the order of the paths."""
    given = settings.numbers('adapt_bounds')
    if given and len(given) != 2 * len(paths):
        rule = f'bounds must be the lowest and highest value of each of {", ".join(paths)}'
        raise ConfigError('adapt', [f'{rule}, got {len(given)} numbers'])
    pairs = zip(given[::2], given[1::2], strict=True)
    return dict(zip(paths, pairs, strict=False))


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
