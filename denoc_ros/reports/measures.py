"""The numbers of a run: tracking, deflection, torque."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from denoc_ros.bags.run import Interval, RecordedTopics, point_columns, point_times
from denoc_ros.bags.series import Series
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import SolverError
from denoc_ros.estimation.turns import continuous_joints, nearest_turns, without_turns
from denoc_ros.parts import optional
from denoc_ros.simulation.recorded.run_snapshots import notable_deflections
from denoc_ros.trajectories import SplineTrajectory
from denoc_ros.types import Array
from denoc_ros.units import deflection_unit

ASKED_TOPICS = ('up/asked', 'shaper/input')  # what a shaped reference was shaped from
ROUNDING = 1e-12  # rad
LONG_ENOUGH = 0.5  # s after the stop that say something of swing
SETTLED = 3.0  # s after the stop from which on an arm should be at rest
REACTING = 1001  # moments of a motion to which a floating base reacts
POSES = 2000  # per phase: enough for an rms, each costs a pass over the links


@dataclass(frozen=True)
class Deflection:
    """One deflection of a phase, predicted and true; at least one of them is there."""

    name: str  # link/component
    t: Array  # (k,) s since the phase began
    predicted: Array | None  # (k,) m or rad, None where nothing predicts
    true: Array | None  # (k,), None where there is no judge

    @property
    def error(self) -> Array | None:
        """Predicted minus true, (k,); None where there is only one of them."""
        if self.predicted is None or self.true is None:
            return None
        return np.asarray(self.predicted - self.true)

    @property
    def unit(self) -> str:
        """Metres, or radians of a turn."""
        return deflection_unit(self.name)


@dataclass(frozen=True)
class PhaseMeasures:
    """Measures of one phase; times count from its reference's start.

    A reference may end before the phase does: then what follows is how the robot comes to rest.
    """

    name: str
    begin: float  # of what is shown, since the recording's origin [s]
    end: float  # s
    joints: Series | None  # measured positions
    error: Series | None  # reference minus measured [rad, m]
    tip_error: Series | None  # distance of the deflected tip from where it was asked to be [m]
    stop: float  # when the motion that was asked for ends [s]; NaN where none was
    torque: Series | None  # commanded [N m, N]
    effort: Series | None  # as measured [N m, N]
    deflections: tuple[Deflection, ...]

    @property
    def moving(self) -> Array | None:
        """The tip's error until the stop, (k,) [m]."""
        return None if self.tip_error is None else self._tip(self.tip_error.t <= self.stop)

    @property
    def swing(self) -> Array | None:
        """The tip's error from the stop on, (k,) [m]; None where the phase ends with it."""
        return self._after(0.0)

    @property
    def settled(self) -> Array | None:
        """The tip's error from `SETTLED` s after the stop on, (k,) [m]; None if there is none."""
        return self._after(SETTLED)

    def _after(self, seconds: float) -> Array | None:
        begin = self.stop + seconds
        if self.tip_error is None or not self.tip_error.t[-1] > begin + LONG_ENOUGH:
            return None
        return self._tip(self.tip_error.t > begin)

    def _tip(self, rows: NDArray[np.bool_]) -> Array:
        assert self.tip_error is not None
        return np.asarray(self.tip_error.values[rows, 0])


def measure(
    recording: RecordedTopics, robot: Robot | None, tip: str, names: Sequence[str] = ()
) -> tuple[PhaseMeasures, ...]:
    """Measure each phase of a recording, or those of some names.

    Parameters
    ----------
    robot : Robot or None
        The robot, for the tip's error; None leaves that out.
    """
    return tuple(
        _phase(recording, interval, robot, tip)
        for interval in recording.phases
        if not names or interval.name in names
    )


def summarize(phases: tuple[PhaseMeasures, ...]) -> dict[str, Any]:
    """Return the numbers of the phases, ready for JSON: SI units, rms and largest values."""
    return {phase.name: _phase_summary(phase) for phase in phases}


def rms(values: Array) -> float:
    """Return the root mean square of the finite values, 0 if there are none."""
    finite = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(finite**2))) if len(finite) else 0.0


def peak(values: Array) -> float:
    """Return the largest magnitude of the finite values, 0 if there are none."""
    return float(np.max(np.abs(values[np.isfinite(values)]), initial=0.0))


def _phase(
    recording: RecordedTopics, interval: Interval, robot: Robot | None, tip: str
) -> PhaseMeasures:
    reference = _reference(recording, interval)
    asked = next(
        (each for topic in ASKED_TOPICS if (each := _reference(recording, interval, topic))),
        reference,
    )
    start, end = interval.start, interval.end
    if reference is not None:
        start, last = reference.start, max(reference.end, asked.end if asked else 0.0)
        if end < last + LONG_ENOUGH:  # what is left of the phase says nothing
            end = min(end, last)
    elif not np.isfinite(start):
        start = 0.0
    joints = recording.joints('joint_states')
    if joints is not None and robot is not None:
        joints = without_turns(joints.ascending(), robot.tree)
    measured = _cut(None if joints is None else joints.field('position'), start, end)
    return PhaseMeasures(
        name=interval.name,
        begin=interval.start if reference is None else start,
        end=end,
        joints=measured,
        error=_tracking(measured, reference, robot),
        tip_error=_tip_error(recording, asked, robot, tip, start, end),
        stop=float('nan') if asked is None else asked.end - start,
        torque=_cut(recording.series('feedforward/effort', 'effort'), start, end),
        effort=_cut(recording.series('joint_states', 'effort'), start, end),
        deflections=_deflections(recording, start, end),
    )


def _cut(series: Series | None, start: float, end: float) -> Series | None:
    """Return the rows of an interval, with times counted from its start."""
    if series is None:
        return None
    part = series.between(start, end)
    return Series(part.t - start, part.names, part.values) if len(part.t) > 1 else None


class _Reference:
    """The trajectory that a phase was to follow, by joint names; time since the recording."""

    def __init__(self, start: float, names: tuple[str, ...], times: Array, rows: Any) -> None:
        self.start, self.names = start, names
        self.end = start + float(times[-1])
        # the same curve as the nodes follow
        self._curve = SplineTrajectory(times, *point_columns(rows))

    def at(self, t: Array) -> Array:
        """Return positions (k, n) at times since the start."""
        q, qd, qdd = np.zeros((3, len(t), len(self.names)))
        for row, now in enumerate(t):
            self._curve.sample(float(now), q[row], qd[row], qdd[row])
        return q


def _reference(
    recording: RecordedTopics, interval: Interval, topic: str = 'reference'
) -> _Reference | None:
    """Return the phase's last trajectory of many points; streamed points are joined to one."""
    streamed = []
    for item in reversed(recording.messages(topic)):
        if not interval.start <= item.log_time < interval.end:
            continue
        message, start = item.message, item.stamp
        names = tuple(message.joint_names)
        if len(message.points) > 1:
            return _Reference(start, names, point_times(message.points), message.points)
        streamed.append((start, names, message.points[0]))
    if len(streamed) < 2:
        return None
    streamed.reverse()
    starts = np.array([entry[0] for entry in streamed])
    keep = np.concatenate(([True], np.diff(starts) > 0.0))
    rows = [entry[2] for entry, kept in zip(streamed, keep, strict=True) if kept]
    return _Reference(float(starts[0]), streamed[0][1], (starts - starts[0])[keep], rows)


def _tracking(
    measured: Series | None, reference: _Reference | None, robot: Robot | None
) -> Series | None:
    if measured is None or reference is None:
        return None
    names = tuple(name for name in measured.names if name in reference.names)
    if not names:
        return None
    columns = [reference.names.index(name) for name in names]
    wanted = reference.at(measured.t)[:, columns]
    values = measured.select(names).values
    if robot is not None:
        values = nearest_turns(values, wanted, continuous_joints(robot.tree, names))
    error = wanted - values
    # A played bag is its own reference: there is nothing to track.
    return Series(measured.t, names, error) if np.abs(error).max() > ROUNDING else None


def _tip_error(
    recording: RecordedTopics,
    asked: _Reference | None,
    robot: Robot | None,
    tip: str,
    start: float,
    end: float,
) -> Series | None:
    true = _cut(recording.series('plant/true_modal_state'), start, end)
    if true is None or asked is None or robot is None:
        return None
    if set(true.names) != set(robot.coordinate_names):
        return None
    rows = np.linspace(0, len(true.t) - 1, min(POSES, len(true.t))).astype(np.intp)
    q = np.ascontiguousarray(true.select(tuple(robot.coordinate_names)).values[rows])
    wanted = np.zeros_like(q)
    if robot.tree.loops:
        wanted[:, robot.joint_indices] = q[:, robot.joint_indices]
    places = [robot.coordinate_names.index(name) for name in asked.names]
    times = true.t[rows] + start - asked.start
    wanted[:, places] = asked.at(times)
    if len(robot.base_indices):
        planner = optional('planning.tip.asked_motion')
        if robot.tree.loops or planner is None:
            return None
        wanted[:, robot.base_indices] = _reacting(planner, robot, asked, times)
    try:
        wanted = robot.assemble(wanted, fixed=asked.names)
    except SolverError:
        return None
    gap = robot.frame_pose(tip, q) - robot.frame_pose(tip, wanted)
    return Series(true.t[rows], (tip,), np.linalg.norm(gap[:, :3, 3], axis=1)[:, np.newaxis])


def _reacting(planner: Any, robot: Robot, asked: _Reference, times: Array) -> Array:
    """Return how (k, 6) a floating base reacts to the undeformed arm, from zero coordinates on."""
    at: Array = np.linspace(0.0, asked.end - asked.start, REACTING)
    joints = np.zeros((len(at), len(robot.joint_names)))
    joints[:, [robot.joint_names.index(name) for name in asked.names]] = asked.at(at)
    motion = planner.AskedMotion(robot, at, joints)
    return np.asarray(motion.coordinates(times)[:, robot.base_indices])


def _deflections(recording: RecordedTopics, start: float, end: float) -> tuple[Deflection, ...]:
    predicted = _cut(recording.series('predictor/tip_deflection'), start, end)
    true = _cut(recording.series('plant/true_deflection'), start, end)
    shown, judge = predicted or true, true or predicted
    if shown is None or judge is None:
        return ()
    names = [name for name in shown.names if name in judge.names]
    peaks = {name: peak(judge.column(name)) for name in names}
    return tuple(
        Deflection(
            name,
            shown.t,
            None if predicted is None else predicted.column(name),
            None if true is None else true.select((name,)).at(shown.t)[:, 0],
        )
        for name in notable_deflections(peaks, least=1e-9)
    )


def _phase_summary(phase: PhaseMeasures) -> dict[str, Any]:
    summary: dict[str, Any] = {}
    if phase.error is not None:
        summary['joint_error'] = _columns(phase.error)
        summary['joint_error_rms'] = rms(phase.error.values)
    if phase.tip_error is not None:
        summary['tip_error'] = _extent(phase.tip_error.values[:, 0])
    if phase.moving is not None and phase.swing is not None:
        summary['tip_error_moving'] = _extent(phase.moving)
        summary['tip_error_after_stop'] = _extent(phase.swing)
    if phase.settled is not None:
        summary['tip_error_settled'] = _extent(phase.settled)
    if phase.torque is not None:
        summary['torque'] = _columns(phase.torque)
    judged = {entry.name: deflection_error(entry) for entry in phase.deflections}
    if found := {name: error for name, error in judged.items() if error is not None}:
        summary['deflection_error'] = found
    return summary


def deflection_error(entry: Deflection) -> dict[str, float] | None:
    """Return rms [m, rad], true peak and percent of it; None without prediction or truth."""
    if entry.error is None or entry.true is None:
        return None
    error, largest = rms(entry.error), peak(entry.true)
    return {'rms': error, 'peak': largest, 'percent_of_peak': 100.0 * error / largest}


def _columns(series: Series) -> dict[str, dict[str, float]]:
    return {name: _extent(series.column(name)) for name in series.names}


def _extent(values: Array) -> dict[str, float]:
    return {'rms': rms(values), 'max': peak(values)}
