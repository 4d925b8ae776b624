"""Limits of a motion as rows: each quantity over its limit at each moment, and its derivatives."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from denoc_ros.dynamics.driven.joint_limits import Given, JointLimits, joint_limits
from denoc_ros.dynamics.driven.motion_grid import differences
from denoc_ros.dynamics.driven.motion_plan import LimitUse, Plan
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import StateError
from denoc_ros.model.tree import Body
from denoc_ros.settings import documented, optional, positive, require_declared, setting
from denoc_ros.types import Array

Int = NDArray[np.int64]
STATIONS = 9  # of each segment of a beam at which strain and moment are looked at
PLACES = 50  # along a motion at which limits may be narrower
LITTLE = 1e-6  # m, rad: of differences of nearly linear deflections
# limits by name, with their units
JOINTS = {
    'velocity': 'rad/s, m/s',
    'acceleration': 'rad/s^2, m/s^2',
    'jerk': 'rad/s^3, m/s^3',
    'effort': 'N m, N',
    'effort_rate': 'N m/s, N/s',
}
BEAMS = {'strain': '1', 'moment': 'N m', 'deflection': 'm'}
TIPS = ('tip_speed', 'tip_acceleration', 'power')


@dataclass(frozen=True)
class PlanLimits:
    """Limits of a motion of a flexible robot.

    Attributes
    ----------
    joints : JointLimits
        Of all joints.
    strain, moment, deflection : mapping of link to float
        Largest outer-fibre strain [1] and bending moment [N m] at any station of a link's beam,
        and deflection of its tip [m].
    tip_speed, tip_acceleration : float
        Of the tips [m/s, m/s^2].
    power : float
        That the joints draw together [W]; a joint that brakes gives none back.
    """

    joints: JointLimits
    strain: Mapping[str, float]
    moment: Mapping[str, float]
    deflection: Mapping[str, float]
    tip_speed: float = np.inf
    tip_acceleration: float = np.inf
    power: float = np.inf


@documented
@dataclass(frozen=True, kw_only=True)
class LimitOptions:
    """Limits that the options of a method may give.

    Attributes
    ----------
    velocity, acceleration, jerk, effort, effort_rate : optional
        Limits of the driven joints in place of the URDF's, which has none of acceleration, jerk
        and effort rate: a number, one per joint, or by joint name.
    strain, moment, deflection : optional
        Limits of beams, a number or by link: outer-fibre strain [1] in place of the file's,
        bending moment [N m], deflection of the tip [m].
    cancel : callable, optional
        Returns True where the work must end: SolverError then.

    Raises
    ------
    StateError
        If a number is out of range.
    """

    velocity: Given | None = None
    acceleration: Given | None = None
    jerk: Given | None = None
    effort: Given | None = None
    effort_rate: Given | None = None
    strain: Given | None = None
    moment: Given | None = None
    deflection: Given | None = None
    tip_speed: float | None = optional(float, 'largest speed of a tip', 'm/s', positive=True)
    tip_acceleration: float | None = optional(
        float, 'largest acceleration of a tip', 'm/s^2', positive=True
    )
    power: float | None = optional(
        float, 'largest power that the joints draw together', 'W', positive=True
    )
    margin: float = setting(
        0.0, 'share of every limit but positions that is kept free', '', 0.0, below=1.0
    )
    uncertainty: float = setting(
        0.0,
        "share by which the links' stiffness and the load may be off: the plan then says how "
        'much of each limit would be used',
        '',
        0.0,
        below=1.0,
    )
    output_step: float = positive(0.004, 'time between the rows of the plan', 's')
    cancel: Callable[[], bool] | None = None

    def __post_init__(self) -> None:
        require_declared(self, 'shape_motion')

    def limits(self, robot: Robot) -> PlanLimits:
        """Return the limits of a robot with these options."""
        joints = {what: getattr(self, what) for what in JOINTS}
        return motion_limits(
            robot, joints, {what: getattr(self, what) for what in (*BEAMS, *TIPS)}, self.margin
        )


def motion_limits(
    robot: Robot,
    joints: Mapping[str, Given | None],
    beyond: Mapping[str, Given | None],
    margin: float = 0.0,
) -> PlanLimits:
    """Return the limits of a robot's file, or those given.

    Parameters
    ----------
    robot : Robot
    joints : mapping
        `velocity`, `acceleration`, `jerk`, `effort`, `effort_rate`: see :func:`joint_limits`.
    beyond : mapping
        `strain`, `moment`, `deflection`: a number for all beams, or by link; `tip_speed`,
        `tip_acceleration`, `power`: a number. None: the file's (it has strains only).
    margin : float
        Share of every limit but positions that is kept free.

    Raises
    ------
    StateError
        A limit that is not > 0, or of an unknown joint or link; a strain where nothing tells how
        far its outer fibre is.
    """
    own = joint_limits(robot, **joints).scaled(1.0 - margin)
    beams = [body for body in robot.tree.bodies if body.beam is not None]
    links = sorted({body.link for body in beams})
    file = {
        body.link: body.beam.strain_limit
        for body in beams
        if body.beam is not None and np.isfinite(body.beam.strain_limit)
    }
    found = {what: _of_links(what, beyond.get(what), links) for what in BEAMS}
    found['strain'] = {**file, **found['strain']}
    for body in beams:
        if body.link in found['strain'] and body.beam is not None and not any(body.beam.surface):
            raise StateError(
                f'limits: strain of {body.link!r} must come with a <section> or the attribute '
                'surface of its <beam>, got neither'
            )
    numbers = {what: _positive(what, beyond.get(what)) for what in TIPS}
    scaled = {
        what: {link: (1.0 - margin) * limit for link, limit in each.items()}
        for what, each in found.items()
    }
    pace = {what: (1.0 - margin) * numbers[what] for what in TIPS}
    return PlanLimits(own, scaled['strain'], scaled['moment'], scaled['deflection'], **pace)


def _of_links(what: str, given: Given | None, links: list[str]) -> dict[str, float]:
    if given is None:
        return {}
    each = given if isinstance(given, Mapping) else dict.fromkeys(links, given)
    unknown = sorted(set(each) - set(links))
    if unknown:
        raise StateError(f'limits: {what} must be of beams of {links}, got {unknown[0]!r}')
    return {link: _positive(what, value) for link, value in each.items()}


def _positive(what: str, value: object) -> float:
    if value is None:
        return np.inf
    good = isinstance(value, int | float | np.number) and float(value) > 0.0
    if not good:
        raise StateError(f'limits: {what} must be a number > 0, got {value!r}')
    return float(value)  # type: ignore[arg-type]


class Moments(NamedTuple):
    """A motion at moments, or its derivatives with one axis more at the end.

    Attributes
    ----------
    q, qd, qdd : (k, n, …) arrays
    torque : (k, driven, …) array
    """

    q: Array
    qd: Array
    qdd: Array
    torque: Array


Row = tuple[Array, Callable[[Moments], Array]]  # values (k, r), and their change (k, r, p)


class LimitRows:
    """Quantities that have limits, as shares of these.

    Parameters
    ----------
    robot : Robot
        Its workspace is used.
    driven : int array
        Coordinates of the driven joints.
    frames : sequence of str
        The tips.
    limits : PlanLimits
    all_stations : bool
        Whether each station of a beam has a row of its strain or moment, else only the largest:
        that jumps between stations, and a program that bends one of them less does not see the
        next.

    Attributes
    ----------
    names : tuple of str
        A limit and whose.
    row_names : tuple of str
        The same of each row.
    """

    def __init__(
        self,
        robot: Robot,
        driven: Int,
        frames: tuple[str, ...],
        limits: PlanLimits,
        all_stations: bool = False,
    ) -> None:
        self._robot, self._driven, self._frames, self._limits = robot, driven, frames, limits
        names = [robot.coordinate_names[k] for k in driven]
        self._joints = limits.joints.of(
            np.array([robot.joint_names.index(name) for name in names], dtype=np.int64)
        )
        found: list[tuple[str, ...]] = []
        for what in ('position', 'velocity', 'acceleration', 'jerk', 'effort', 'effort_rate'):
            size = self._joints.room if what == 'position' else getattr(self._joints, what)
            found += [(what, name) for name, one in zip(names, size, strict=True) if one < np.inf]
        self._bends: list[tuple[Array, bool]] = []
        self._all_stations = all_stations
        for what, each in (('strain', limits.strain), ('moment', limits.moment)):
            for link, limit in each.items():
                self._bends.append(_bending_rows(robot, link, what, limit))
                found += [(what, link)] * (len(self._bends[-1][0]) if all_stations else 1)
        found += [('deflection', link) for link in limits.deflection]
        for what in TIPS[:2]:
            if getattr(limits, what) < np.inf:
                found += [(what, frame) for frame in frames]
        if limits.power < np.inf:
            found.append(('power', 'all joints'))
        self.row_names = tuple(' '.join(each) for each in found)
        self.names, first = tuple(dict.fromkeys(self.row_names)), self.row_names.index
        self._first = [first(name) for name in self.names]
        self._limit = np.array([self.names.index(name) for name in self.row_names], dtype=np.int64)
        self.widen()

    def widen(self) -> None:
        """Take the limits as they are given."""
        self._narrowed = np.ones((PLACES + 1, len(self.names)))

    def narrow(self, where: Array, shares: Array) -> None:
        """Make limits narrower where shares (k, names) are beyond them.

        `where` (k,) are places along the motion, from 0 to 1.
        """
        beyond = np.ones_like(self._narrowed)
        np.maximum.at(beyond, np.rint(PLACES * where).astype(np.int64), shares)
        beside = np.pad(beyond, ((1, 1), (0, 0)), mode='edge')
        self._narrowed *= np.maximum(np.maximum(beside[:-2], beside[2:]), beyond)

    def narrowed(self, where: Array) -> Array:
        """Return factors of shares (k, rows) at places (k,): 1, or more by narrower limits."""
        at = np.clip(PLACES * where, 0.0, PLACES)
        low = np.minimum(at.astype(np.int64), PLACES - 1)
        share = (at - low)[:, None]
        low_share = (1.0 - share) * self._narrowed[low]
        return np.asarray(low_share + share * self._narrowed[low + 1])[:, self._limit]

    def values(self, at: Moments, step: float) -> Array:
        """Return the shares (k, rows); signed for joints, 1 or -1 at the limit."""
        parts = [value for value, _ in self._rows(at, step)]
        return np.concatenate(parts, axis=1) if parts else np.zeros((len(at.q), 0))

    def shares(self, at: Moments, step: float) -> Array:
        """Return the largest shares (k, names)."""
        values = np.abs(self.values(at, step))
        return np.maximum.reduceat(values, self._first, axis=1) if self._first else values

    def use(self, plan: Plan) -> LimitUse:
        """Return how much of the limits a plan uses."""
        at = Moments(plan.q, plan.qd, plan.qdd, plan.torque)
        step = float(plan.t[-1] - plan.t[0]) / (len(plan.t) - 1)
        return LimitUse(self.names, self.shares(at, step), {})

    def changes(self, at: Moments, step: float, by: Moments) -> Array:
        """Return the derivatives (k, rows, p) of the shares by the motion's parameters."""
        parts = [change(by) for _, change in self._rows(at, step)]
        empty = np.zeros((len(at.q), 0, by.q.shape[-1]))
        return np.concatenate(parts, axis=1) if parts else empty

    def _rows(self, at: Moments, step: float) -> Iterator[Row]:
        own, driven = self._joints, self._driven

        def over(limit: Array, part: Callable[[Moments], Array], middle: Array | float) -> Row:
            """Return a joint's quantity, less its middle, as a share."""
            kept = np.flatnonzero(limit < np.inf)
            value = (part(at) - middle)[:, kept] / limit[kept]
            return value, lambda by: part(by)[:, kept] / limit[kept, None]

        def slope(rows: Array) -> Array:
            return np.asarray(np.gradient(rows, step, axis=0))

        yield over(own.room, lambda m: m.q[:, driven], own.middle)
        yield over(own.velocity, lambda m: m.qd[:, driven], 0.0)
        yield over(own.acceleration, lambda m: m.qdd[:, driven], 0.0)
        yield over(own.jerk, lambda m: slope(m.qdd[:, driven]), 0.0)
        yield over(own.effort, lambda m: m.torque, 0.0)
        yield over(own.effort_rate, lambda m: slope(m.torque), 0.0)
        for rows, corners in self._bends:
            yield _bends(rows, corners, at, self._all_stations)
        for link, limit in self._limits.deflection.items():
            yield self._deflection(link, limit, at)
        yield from self._tips(at, step)
        if self._limits.power < np.inf:
            yield self._power(at)

    def _deflection(self, link: str, limit: float, at: Moments) -> Row:
        robot = self._robot
        whole = np.array([robot.tip_deflection(link, q)[1:] for q in at.q])
        columns = [
            k for k, name in enumerate(robot.coordinate_names) if name.startswith(f'{link}/')
        ]
        rest = np.zeros(robot.n)
        gain = np.zeros((2, robot.n))
        for column in columns:
            moved = rest.copy()
            moved[column] = LITTLE
            gain[:, column] = robot.tip_deflection(link, moved)[1:] / LITTLE

        def change(by: Moments) -> Array:
            return np.asarray(np.einsum('ij,kjp->kip', gain, by.q))

        return _norm(whole, change, limit)

    def _tips(self, at: Moments, step: float) -> Iterator[Row]:
        limits = (self._limits.tip_speed, self._limits.tip_acceleration)
        robot, frames = self._robot, self._frames if min(limits) < np.inf else ()
        places = [robot.frame_pose(frame, at.q)[:, :3, 3] for frame in frames]
        jacobians = [robot.frame_jacobian(frame, at.q)[:, :3] for frame in frames]
        for order, limit in enumerate(limits):
            for place, jacobian in zip(places, jacobians, strict=True) if limit < np.inf else ():

                def change(by: Moments, order: int = order, jacobian: Array = jacobian) -> Array:
                    moved = jacobian @ by.q
                    flat = moved.reshape(len(moved), -1)
                    return differences(flat, step)[order].reshape(moved.shape)

                yield _norm(differences(place, step)[order], change, limit)

    def _power(self, at: Moments) -> Row:
        rate, limit = at.qd[:, self._driven], self._limits.power
        drawn = at.torque * rate
        gives = (drawn > 0.0)[:, :, None]

        def change(by: Moments) -> Array:
            each = by.torque * rate[:, :, None] + at.torque[:, :, None] * by.qd[:, self._driven]
            return np.asarray(np.sum(gives * each, axis=1, keepdims=True) / limit)

        return np.sum(np.maximum(drawn, 0.0), axis=1, keepdims=True) / limit, change


def _norm(vectors: Array, change: Callable[[Moments], Array], limit: float) -> Row:
    """Return the row of the length of vectors (k, c) with changes (k, c, p)."""
    size = np.linalg.norm(vectors, axis=1, keepdims=True)
    along = vectors / np.maximum(size, 1e-12)
    return size / limit, lambda by: np.einsum('kc,kcp->kp', along, change(by))[:, None] / limit


def _bends(rows: Array, corners: bool, at: Moments, every: bool) -> Row:
    """Return rows of the bends at all stations (s, 2, n), or of the largest at each moment."""
    here = np.einsum('sin,kn->ksi', rows, at.q)
    sizes = np.abs(here).sum(axis=2) if corners else np.linalg.norm(here, axis=2)
    stations = np.arange(len(rows))[None] if every else sizes.argmax(axis=1)[:, None]
    here = np.take_along_axis(here, stations[:, :, None], axis=1)
    sizes = np.take_along_axis(sizes, stations, axis=1)
    along = np.sign(here) if corners else here / np.maximum(sizes, 1e-12)[:, :, None]
    gain = np.einsum(
        'ksi,ksin->ksn', along, np.broadcast_to(rows[stations], (*here.shape, rows.shape[2]))
    )
    return sizes, lambda by: gain @ by.q


def _bending_rows(robot: Robot, link: str, what: str, limit: float) -> tuple[Array, bool]:
    """Return bends (stations, 2, n) in y and z over a limit, and whether corners add them up."""
    found, corners = [], False
    for body in robot.tree.bodies:
        if body.link == link and body.beam is not None:
            corners = corners or (what == 'strain' and body.beam.corners)
            found.append(_segment_rows(robot, body, what))
    return np.concatenate(found) / limit, corners


def _segment_rows(robot: Robot, body: Body, what: str) -> Array:
    beam = body.beam
    assert beam is not None
    at = np.linspace(0.0, beam.length, STATIONS)
    rows = np.zeros((STATIONS, 2, robot.n))
    for k, part in enumerate((beam.y, beam.z)):
        if part is None or not part.modes:
            continue
        names = [f'{body.name}/{"yz"[k]}{j + 1}' for j in range(part.modes)]
        size = np.full(STATIONS, beam.surface[k])
        if what == 'moment':
            size = part.stiffness_at(at / beam.length)
        columns = [robot.coordinate_names.index(name) for name in names]
        rows[:, k, columns] = size[:, None] * part.shapes.curvatures(at)
    return rows
