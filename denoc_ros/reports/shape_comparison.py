"""A plan compared with its input motion, on the model and on wrong models."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from denoc_ros.control.asked_motion import AskedMotion
from denoc_ros.control.carried_out import CarriedOut, DrivenMotion, carry_out, planned
from denoc_ros.control.plan import Plan
from denoc_ros.control.shape import tip_frames
from denoc_ros.control.shaped_samples import rest_spline
from denoc_ros.dynamics.robot import Robot
from denoc_ros.types import Array

ROWS = 1200  # of a run
PERIODS = 2.0  # of the lowest mode, that are looked at after the stop
SHARE = 0.2  # by which models are off
PARTS = ('y', 'z', 'torsion')


@dataclass(frozen=True)
class Tracked:
    """A run: times (k,) [s], tip error (k,) [m], and the error after the motion."""

    t: Array
    error: Array
    moving: NDArray[np.bool_]  # (k,)
    swing: float  # m, from where it comes to rest, after the stop

    @property
    def rms(self) -> float:
        """Root mean square of the error while moving [m]."""
        error = self.error[self.moving]
        return float(np.sqrt(np.mean(error**2)))

    @property
    def after(self) -> float:
        """Largest error after the stop [m]."""
        return float(self.error[self.t >= self.t[self.moving].max()].max(initial=0.0))


@dataclass(frozen=True)
class Variation:
    """A wrong model, with the tip errors of the input motion and of the plan on it."""

    name: str
    plain: Tracked
    shaped: Tracked


@dataclass(frozen=True)
class PlanComparison:
    """Comparison of a plan with the plain motion.

    Attributes
    ----------
    plan : Plan
    frame : str
    asked : (k, joints) array
        The driven joints of the motion that was asked for, at the plan's times.
    plain, shaped : Tracked
        Joints on the motion that was asked for, and on the plan.
    variations : tuple of Variation
    """

    plan: Plan
    frame: str
    asked: Array
    plain: Tracked
    shaped: Tracked
    variations: tuple[Variation, ...]

    def summary(self) -> dict[str, Any]:
        """Return the figures, ready for JSON."""
        return {
            'simulated': {'plain': _figures(self.plain), 'shaped': _figures(self.shaped)},
            'variations': {
                one.name: {'plain': _figures(one.plain), 'shaped': _figures(one.shaped)}
                for one in self.variations
            },
        }


def _figures(run: Tracked) -> dict[str, float]:
    return {'moving_rms_m': run.rms, 'after_m': run.after, 'swing_m': run.swing}


class _Judge:
    """Carries out both motions on a robot and says how far the tip is off.

    The undeformed robot on the motion that was asked for says where the tip should be.
    """

    def __init__(self, robot: Robot, plan: Plan, motion: tuple[Array, Array], frame: str) -> None:
        self._plan, self.frame = plan, frame
        motion = _retimed(plan, motion)
        times = motion[0]
        self._first, self._last = float(times[0]), float(times[-1])
        self._spline = rest_spline(times, motion[1])
        self._motion = AskedMotion(robot, times - self._first, motion[1])
        self._near = np.zeros(robot.n)
        self._near[robot.joint_indices] = motion[1][0]
        self._driven = [robot.joint_names.index(name) for name in plan.joint_names]
        columns = [plan.coordinate_names.index(name) for name in robot.coordinate_names]
        lowest = _lowest(robot, plan.q[-1, columns])
        self._tail = min(PERIODS / lowest, 2.0 * (self._last - self._first)) if lowest else 0.0
        self._wanted = self._undeformed(robot)

    def asked(self, times: Array) -> tuple[Array, Array, Array]:
        """Return the driven joints' positions, rates and accelerations as they were asked for."""
        at = np.clip(times, self._first, self._last)
        inside = ((times >= self._first) & (times <= self._last))[:, None]
        q, qd, qdd = (
            np.asarray(self._spline(at, order), dtype=np.float64)[:, self._driven]
            for order in range(3)
        )
        return q, qd * inside, qdd * inside

    def track(self, robot: Robot, shaped: bool) -> Tracked:
        """Return the run of the plan, or of the motion as it was asked for."""
        plan = self._plan
        motion: DrivenMotion = planned(plan, plan.joint_names) if shaped else self.asked
        end = max(self._last, float(plan.t[-1])) + self._tail
        times: Array = np.linspace(min(float(plan.t[0]), self._first), end, ROWS)
        run = carry_out(robot, motion, plan.joint_names, self._near, times)
        apart = run.tip(robot, self.frame) - self._positions(times)
        stop = max(self._last, float(plan.t[-1])) if shaped else self._last
        return self._tracked(robot, run, apart, stop)

    def _tracked(self, robot: Robot, run: CarriedOut, apart: Array, stop: float) -> Tracked:
        moving = (run.t >= self._first) & (run.t <= stop)
        swing = run.swing(robot, self.frame, stop)
        return Tracked(run.t, np.linalg.norm(apart, axis=1), moving, swing)

    def _undeformed(self, robot: Robot) -> tuple[Array, Array]:
        """Return times and positions of the tip of the undeformed robot on the motion."""
        times: Array = np.linspace(self._first, self._last, ROWS)
        q = self._motion.coordinates(times - self._first)
        if robot.constraint_names:
            fixed = list(self._plan.joint_names)
            for row in range(ROWS):
                if row:
                    passive = np.setdiff1d(np.arange(robot.n), robot.indices(fixed))
                    q[row, passive] = q[row - 1, passive]
                q[row] = robot.assemble(q[row], fixed=fixed)
        return times, robot.frame_pose(self.frame, q)[:, :3, 3]

    def _positions(self, times: Array) -> Array:
        at, places = self._wanted
        spline = rest_spline(at, places)
        return np.asarray(spline(np.clip(times, at[0], at[-1])), dtype=np.float64)


def _retimed(plan: Plan, motion: tuple[Array, Array]) -> tuple[Array, Array]:
    """Return the motion that was asked for with the timing that the plan has."""
    times, joints = motion
    if plan.passed is None:
        return times[0] + plan.stretch * (times - times[0]), joints
    inside = (plan.t >= plan.t[0] + plan.preaction) & (plan.t <= plan.t[-1] - plan.postaction)
    passed, at = plan.passed[inside], plan.t[inside]
    even = np.linspace(at[0], at[-1], ROWS)
    where = times[0] + np.interp(even, at, passed)
    return even, np.asarray(rest_spline(times, joints)(np.clip(where, times[0], times[-1])))


def _lowest(robot: Robot, q: Array) -> float:
    """Return the lowest natural frequency with the joints held [Hz], 0 where there is none."""
    if not len(robot.flexible_indices):
        return 0.0
    found = robot.natural_frequencies(q)
    found = found[found > 0.0]
    return float(found.min()) if len(found) else 0.0


def compare(
    robot: Robot,
    plan: Plan,
    motion: tuple[Array, Array],
    tip: str | Sequence[str] | None,
    progress: Callable[[float], object] | None = None,
) -> PlanComparison:
    """Return the results of a plan and of its input motion.

    Parameters
    ----------
    robot : Robot
        Its base is held if the plan is of one that thrusters hold.
    plan : Plan
    motion : (k,) and (k, joints) arrays
        Times and joints that were asked for.
    tip : str or sequence of str, optional
        The frames that matter; the first is looked at.
    progress : callable, optional
        Called with each further share of the work; they add up to 1.
    """
    frame = tip_frames(robot, tip)[0]
    judge = _Judge(robot, plan, motion, frame)
    others = variations(robot)
    done = progress or (lambda _share: None)
    share = 1.0 / (1 + len(others))
    plain, shaped = (judge.track(robot, which) for which in (False, True))
    done(share)
    found = []
    for name, changes in others.items():
        other = robot.with_overrides(changes)
        tracked = (judge.track(other, which) for which in (False, True))
        found.append(Variation(name, *tracked))
        done(share)
    return PlanComparison(plan, frame, judge.asked(plan.t)[0], plain, shaped, tuple(found))


def variations(robot: Robot) -> dict[str, dict[str, Any]]:
    """Return models that are off, as overrides by name: each rigidity, payload and damping."""
    found: dict[str, dict[str, Any]] = {}
    damping: dict[str, list[float]] = {}
    for body in robot.tree.bodies:
        for direction in PARTS if body.segment == 1 else ():
            part = getattr(body.beam, direction) if body.beam is not None else None
            if part is None or not part.modes:
                continue
            path = f'beam.{body.name}.{direction}'
            rigidity = 'gj' if direction == 'torsion' else 'ei'
            for share in (1.0 - SHARE, 1.0 + SHARE):
                name = f'{path}.{rigidity} {100.0 * (share - 1.0):+.0f} %'
                found[name] = {f'{path}.{rigidity}': share * part.stiffness}
            if part.damping.any():
                damping[f'{path}.damping'] = part.damping.tolist()
    masses = {
        path: value
        for path, value in robot.tree.overrides.items()
        if path.startswith('payload.') and path.endswith('.mass')
    }
    for share in (1.0 - SHARE, 1.0 + SHARE):
        percent = f'{100.0 * (share - 1.0):+.0f} %'
        for path, mass in masses.items():
            found[f'{path} {percent}'] = {path: share * float(mass)}
        if damping:
            found[f'all damping {percent}'] = {
                path: [share * value for value in values] for path, values in damping.items()
            }
    return found
