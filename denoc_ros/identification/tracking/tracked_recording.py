"""Numbers of a robot tracked along a recording, as the predictor would while it runs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np

from denoc_ros.bags.series import joint_state_blocks, read_joint_states
from denoc_ros.dynamics.robot import Robot
from denoc_ros.estimation.base_track import BaseRecord
from denoc_ros.identification.model.sources import Recording, RecordingSettings, read_source
from denoc_ros.identification.tracking.parameter_tracker import ParameterTracker
from denoc_ros.identification.tracking.tracker_settings import TrackerSettings
from denoc_ros.simulation.recorded.adapted import Adapted
from denoc_ros.simulation.recorded.recorded_stream import phase_numbers
from denoc_ros.simulation.recorded.replay_settings import ReplayPlan, ReplaySettings
from denoc_ros.types import Array


@dataclass(frozen=True)
class AdaptSettings:
    """Which numbers are tracked along a recording, and how."""

    paths: tuple[str, ...] = ()  # dotted, `*` for any text; empty: none
    # lowest and highest value by path; default half and one and a half of the present value
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    tracker: TrackerSettings = field(default_factory=TrackerSettings)

    def along(
        self,
        robot: Robot,
        plan: ReplayPlan,
        settings: ReplaySettings,
        base: BaseRecord | None = None,
    ) -> Adapted:
        """Return the numbers that a tracker finds along a bag; see :func:`adapted_along`."""
        return adapted_along(robot, plan, settings, self, base)


def adapted_along(
    robot: Robot,
    plan: ReplayPlan,
    settings: ReplaySettings,
    adapt: AdaptSettings,
    base: BaseRecord | None = None,
) -> Adapted:
    """Return the parameters that a tracker estimates along a bag.

    Parameters
    ----------
    robot : Robot
        With the numbers as they are known.
    plan : ReplayPlan
        What of the bag counts.
    base : BaseRecord, optional
        How the base moves, on the clock of the joint states.

    Raises
    ------
    ConfigError
        Paths that cannot be tracked, wrong bounds, or a robot with loops.
    BagError, IdentificationError
        The bag has too little.
    """
    tracker = ParameterTracker(robot, adapt.paths, adapt.tracker, adapt.bounds, plan.joints)
    if base is not None:
        tracker.base = base.once
    source = plan.source
    reading = RecordingSettings(source.topic, settings.rename, stamp=source.stamp)
    found = read_source(source.path, robot, reading)
    columns = [found.joints.index(joint) for joint in plan.joints]
    origin_ns = _first_stamp_ns(plan)
    effort = _commanded(plan, found, origin_ns) if plan.effort else found.effort[:, columns]
    stamp_ns = origin_ns + np.rint(1e9 * found.t).astype(np.int64)
    inside = phase_numbers(source.phases, stamp_ns) >= 0
    t: list[float] = []
    rows: list[tuple[Array, Array]] = []
    blocks, readings = 0, _calibrated(robot, found)
    place, stamp, value = next(readings)
    for k, now in zip(np.flatnonzero(inside).tolist(), found.t[inside].tolist(), strict=True):
        while stamp <= now:
            tracker.sense(place, stamp, value)
            place, stamp, value = next(readings)
        qd = None if found.velocity is None else found.velocity[k, columns]
        known = effort[k] if np.isfinite(effort[k]).all() else None
        tracker.measure(now, found.position[k, columns], qd, known)
        if tracker.blocks != blocks:
            blocks = tracker.blocks
            t.append(now)
            rows.append((tracker.values.copy(), tracker.deviations))
    p = len(tracker.paths)
    values, deviations = (
        np.array(part).reshape(-1, p) for part in (zip(*rows, strict=True) if rows else ((), ()))
    )
    return Adapted(
        tracker.paths,
        tracker.start,
        tracker.bounds,
        np.array(t),
        values,
        deviations,
        tracker.supported,
        tracker.cause,
        tracker.restarts,
        tracker.failures,
        tracker.model_error,
    )


def _calibrated(robot: Robot, found: Recording) -> Iterator[tuple[int, float, float]]:
    """Yield place, time [s] and calibrated value of the sensors on beams, by time."""
    said = [
        (place, stamp, sensor.gain * raw + sensor.offset)
        for place, sensor in enumerate(robot.tree.sensors)
        if sensor.name in found.sensors
        for stamp, raw in zip(*(part.tolist() for part in found.sensors[sensor.name]), strict=True)
    ]
    yield from sorted(said, key=lambda reading: reading[1])
    while True:
        yield 0, np.inf, 0.0


def _first_stamp_ns(plan: ReplayPlan) -> int:
    """Return the stamp from which times of the recording count [ns]."""
    source = plan.source
    first = next(joint_state_blocks(source.path, [source.topic], 1, source.stamp))[source.topic]
    return int(first.stamp_ns[0])


def _commanded(plan: ReplayPlan, found: Recording, origin_ns: int) -> Array:
    """Return the effort (k, joints) of a topic of its own, the newest at each joint state."""
    source = plan.source
    series = read_joint_states(source.path, plan.effort, None, source.stamp)
    series = series.since(origin_ns).select(plan.joints)
    newest = np.searchsorted(series.t, found.t, side='right') - 1
    there = newest >= 0
    effort = np.full((len(found.t), len(plan.joints)), np.nan)
    effort[there] = series.effort[newest[there]]
    return effort
