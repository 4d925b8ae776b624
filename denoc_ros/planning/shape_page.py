"""The page of `denoc shape`: tip error before and after, joints, torque, wrong models."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from denoc_ros.dynamics.driven.motion_plan import LimitUse, Plan
from denoc_ros.dynamics.robot import Robot
from denoc_ros.model.joint_units import Units
from denoc_ros.model.numbers import match, numbers_of, values_of
from denoc_ros.model.tree import Tree
from denoc_ros.pages.figures import Curve, Ink, Panel, line_figure
from denoc_ros.pages.html_page import (
    Card,
    PageSection,
    PageTable,
    ReportPage,
    Verdict,
    engineering,
)
from denoc_ros.planning.plan_simulation import JointLaw, carry_out, planned
from denoc_ros.planning.shape_motion import tip_frames
from denoc_ros.planning.shapers.shaped_samples import rest_spline
from denoc_ros.planning.tip.asked_motion import AskedMotion
from denoc_ros.types import Array

ROWS = 1200  # of a run
PERIODS = 2.0  # of the lowest mode, that are looked at after the stop
SHARE = 0.2  # by which models are off
TITLES = {'tip': 'The tip goes where it should'}
PLAIN, SHAPED = 'as it was asked for', 'as it was planned'
HEIGHT = 2.4  # inches
WORSE = 1.0  # times the plain motion's swing: a plan that leaves more is doubtful


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
    """Comparison of a plan with the plain motion."""

    plan: Plan
    frame: str
    # (k, joints) the driven joints of the motion that was asked for, at the plan's times
    asked: Array
    # plain, shaped: joints on the motion that was asked for, and on the plan
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
        motion: JointLaw = planned(plan, plan.joint_names) if shaped else self.asked
        end = max(self._last, float(plan.t[-1])) + self._tail
        times: Array = np.linspace(min(float(plan.t[0]), self._first), end, ROWS)
        run = carry_out(robot, motion, plan.joint_names, self._near, times)
        apart = run.tip(robot, self.frame) - self._positions(times)
        stop = max(self._last, float(plan.t[-1])) if shaped else self._last
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
    values = values_of(robot.tree)
    moving = [path for path, number in numbers_of(robot.tree).items() if number.coordinates]
    damping = [path for path in match(moving, 'beam.*.damping') if np.any(values[path])]
    shares = {f'{100.0 * change:+.0f} %': 1.0 + change for change in (-SHARE, SHARE)}
    found: dict[str, dict[str, Any]] = {
        f'{path} {percent}': {path: float(share * np.asarray(values[path]))}
        for path in match(moving, 'beam.*.ei', 'beam.*.gj')
        for percent, share in shares.items()
    }
    for percent, share in shares.items():
        for link, payload in robot.tree.payloads.items():
            path = f'payload.{link}.mass'
            found[f'{path} {percent}'] = {path: share * payload.mass}
        if damping:
            found[f'all damping {percent}'] = {
                path: (share * np.asarray(values[path])).tolist() for path in damping
            }
    return found


def page(found: PlanComparison, tree: Tree, provenance: Mapping[str, str]) -> ReportPage:
    """Return the page."""
    plan, units = found.plan, Units.of(tree)
    return ReportPage(
        title=TITLES.get(plan.method, 'A motion without swing'),
        subtitle=f'{tree.name} · method {plan.method} · frame {found.frame}',
        verdict=_verdict(found),
        cards=_cards(found),
        sections=[
            _tip(found),
            _joints(found, units),
            _torque(found, units),
            _models(found) if found.variations else None,
            _method(found),
        ],
        provenance=provenance,
    )


def _verdict(found: PlanComparison) -> Verdict:
    plain, shaped = found.plain, found.shaped
    text = (
        f'The tip strays by {engineering(shaped.rms, "m")} rms while it moves, where the motion '
        f'as it was asked for makes it stray by {engineering(plain.rms, "m")}; after the stop it '
        f'swings by {engineering(shaped.swing, "m")}, where it would by '
        f'{engineering(plain.swing, "m")}.'
    )
    worst = max([one.shaped.swing for one in found.variations], default=shaped.swing)
    return Verdict(text, 'good' if worst <= WORSE * plain.swing else 'doubtful')


def _cards(found: PlanComparison) -> list[Card]:
    plan = found.plan

    def both(what: str) -> list[tuple[str, str]]:
        motions = ((PLAIN, found.plain), (SHAPED, found.shaped))
        return [(name, engineering(getattr(motion, what), 'm')) for name, motion in motions]

    cards = [
        Card('Tip off while moving, rms', rows=both('rms')),
        Card('Swing after the stop', '', 'from where it comes to rest', both('swing')),
        Card('Joints move before', engineering(plan.preaction, 's')),
        Card('Joints move after', engineering(plan.postaction, 's')),
    ]
    if plan.passed is not None:
        cards.append(Card('Time, of that asked for', f'{plan.stretch:.4g}', 'least within limits'))
    elif plan.stretch > 1.0:
        cards.append(Card('Slower by', f'{plan.stretch:.4g}', 'to keep the limits'))
    if plan.delay > 0.0:
        cards.append(Card('Arrives later by', engineering(plan.delay, 's')))
    return cards


def _tip(found: PlanComparison) -> PageSection:
    pairs = zip((PLAIN, SHAPED), Ink.PHASES, (found.plain, found.shaped), strict=False)
    curves = [Curve(name, colour, run.t, run.error) for name, colour, run in pairs]
    least = 1e-3 * max(1e-9, min(found.plain.rms, found.shaped.rms))
    logarithmic = [Curve(c.label, c.colour, c.t, np.maximum(c.y, least)) for c in curves]
    figure = line_figure(
        [
            Panel('Tip off what was asked', 'm', curves),
            Panel('The same, logarithmic', 'm', logarithmic, log_y=True),
        ],
        HEIGHT,
    )
    text = (
        'Where the tip is, off where the undeformed robot on the motion that was asked for would '
        'have it; simulated on this model, the joints exactly on either motion.'
    )
    return PageSection('The tip', text, [figure])


def _joints(found: PlanComparison, units: Units) -> PageSection:
    plan = found.plan
    columns = [plan.coordinate_names.index(name) for name in plan.joint_names]
    panels = []
    for k, (name, column) in enumerate(zip(plan.joint_names, columns, strict=True)):
        before = Curve(PLAIN, Ink.PHASES[0], plan.t, found.asked[:, k], dashed=True)
        after = Curve(SHAPED, Ink.PHASES[1], plan.t, plan.q[:, column])
        apart = Curve('difference', Ink.DIFFERENCE, plan.t, plan.q[:, column] - found.asked[:, k])
        panels += [
            Panel(name, units.position(name), [before, after]),
            Panel(f'{name}: planned − asked', units.position(name), [apart]),
        ]
    text = 'What the joints do so that the tip does what was asked.'
    return PageSection('Joints', text, [line_figure(panels)])


def _torque(found: PlanComparison, units: Units) -> PageSection:
    plan = found.plan
    panels = [
        Panel(name, units.effort(name), [Curve(SHAPED, Ink.PHASES[1], plan.t, column)])
        for name, column in zip(plan.joint_names, plan.torque.T, strict=True)
    ]
    figures = [line_figure(panels)]
    text = 'What the joints need for it, on this model.'
    use, tables = plan.limits, []
    if use is not None and use.names:
        text += ' Below, how much of its limits the plan uses at each instant, and which binds.'
        figures.append(line_figure([Panel('Largest share of a limit', '', _binding(plan, use))]))
        most = use.largest
        head = ['limit', 'largest share', 'time gained by 1 % more']
        head += ['with other stiffness and load'] if use.spread else []
        used = sorted(most, key=lambda name: (-use.gains.get(name, 0.0), -most[name]))
        tables = [
            PageTable(
                head,
                [
                    [
                        name,
                        f'{most[name]:.3f}',
                        f'{100.0 * use.gains.get(name, 0.0):.2f} %',
                        *([f'{use.spread[name]:.3f}'] if use.spread else []),
                    ]
                    for name in used
                ],
            )
        ]
    return PageSection('Torque', text, figures, tables=tables)


def _binding(plan: Plan, use: LimitUse) -> list[Curve]:
    """Return the strip: the largest share in grey, and a colour for each limit where it binds."""
    largest = use.shares.max(axis=1)
    curves = [Curve('largest share', Ink.DIFFERENCE, plan.t, largest)]
    binds = np.array(use.binding())
    often = sorted({name for name in binds if name}, key=lambda name: -(binds == name).sum())
    for name, colour in zip(often, Ink.PHASES, strict=False):
        curves.append(Curve(name, colour, plan.t, np.where(binds == name, largest, np.nan)))
    return curves


def _models(found: PlanComparison) -> PageSection:
    head = ['model', 'moving, rms', 'swing after', 'swing after, motion as asked']
    rows = [_row('as it is', found.plain, found.shaped)]
    rows += [_row(one.name, one.plain, one.shaped) for one in found.variations]
    text = (
        'The same plan, joints exactly on it, on models that are off by 20 % in one number each: '
        'what to expect of a real robot. Where this is too much, state feedback or an input '
        'shaper is the better choice.'
    )
    return PageSection('If the model is off', text, tables=[PageTable(head, rows)])


def _row(name: str, plain: Tracked, shaped: Tracked) -> list[str]:
    values = (shaped.rms, shaped.swing, plain.swing)
    return [name, *(engineering(value, 'm') for value in values)]


def _method(found: PlanComparison) -> PageSection:
    left = engineering(found.plan.equation_error, 'm')
    text = (
        'Joints and links are planned together over the whole time: the equations of motion of '
        'the links hold at every instant, and the tip is where it should be as nearly as they '
        'allow (docs/control.md). Between the nodes of its grid the plan leaves forces without '
        f'an actuator that would bend a link by {left} rms.'
        if found.plan.method == 'tip'
        else 'Input shapers and motions from rest to rest: docs/control.md.'
    )
    return PageSection('How this is worked out', text)
