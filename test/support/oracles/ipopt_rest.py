"""Least times of planar arms with flexible links from rest to rest, by CasADi and IPOPT.

An own model (d'Alembert's forces of points of clamped beams, by symbols) and an own transcription:
collocation at Gauss points, torques free at each of them, so that they may jump.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
import scipy.linalg
from numpy.polynomial.legendre import leggauss

from denoc_ros.types import Array

ROOTS = np.array([1.875104068711961, 4.694091132974175])  # of a clamped beam
POINTS = 8  # of Gauss along a beam
STATIONS = 9  # of each link at which a strain is looked at
ORDER = 3  # points of collocation in an interval
OPTIONS: dict[str, Any] = {
    'print_time': False,
    'ipopt': {'print_level': 0, 'sb': 'yes', 'tol': 1e-6, 'max_iter': 600},
}


@dataclass(frozen=True)
class Beams:
    """An arm of equal flexible links in a plane, of two modes each.

    Attributes
    ----------
    links : int
    length, mass, ei : float
        Of each link [m, kg, N m^2].
    armature : float
        Inertia of the rotor at each joint [kg m^2].
    gravity : float
        Along y [m/s^2].
    """

    links: int
    length: float
    mass: float
    ei: float
    armature: float = 0.0
    gravity: float = 0.0

    @property
    def n(self) -> int:
        """Coordinates: of each link the joint and two amplitudes [rad, m, m]."""
        return 3 * self.links

    def shapes(self, x: Array, order: int = 0) -> Array:
        """Return both shapes (2, k) at x (k,) along a link, or their derivatives."""
        beta = (ROOTS / self.length)[:, None]
        z = beta * x
        ratio = ((np.cosh(ROOTS) + np.cos(ROOTS)) / (np.sinh(ROOTS) + np.sin(ROOTS)))[:, None]
        rows = (
            np.cosh(z) - np.cos(z) - ratio * (np.sinh(z) - np.sin(z)),
            beta * (np.sinh(z) + np.sin(z) - ratio * (np.cosh(z) - np.cos(z))),
            beta**2 * (np.cosh(z) + np.cos(z) - ratio * (np.sinh(z) + np.sin(z))),
        )
        return np.asarray(rows[order] * [[0.5], [-0.5]])  # 1 at the tip

    def forces(self) -> ca.Function:
        """Return the forces (n,) of q, q' and q''."""
        q, v, a = (ca.SX.sym(name, self.n) for name in 'qva')
        nodes, weights = leggauss(POINTS)
        x = 0.5 * self.length * (nodes + 1.0)
        points = ca.vertcat(*self._points(q, x))
        rates = ca.jtimes(points, q, v)
        turns = ca.jtimes(rates, q, v) + ca.jtimes(points, q, a)
        masses = np.repeat(np.tile(0.5 * self.mass * weights, self.links), 2)
        down = np.tile([0.0, self.gravity], POINTS * self.links)
        force = ca.jtimes(points, q, masses * (turns - down), True)
        bends = self.shapes(x, 2)
        stiffness = 0.5 * self.length * self.ei * (bends * weights) @ bends.T
        own = [
            ca.vertcat(self.armature * a[3 * k], stiffness @ q[3 * k + 1 : 3 * k + 3])
            for k in range(self.links)
        ]
        return ca.Function('forces', [q, v, a], [force + ca.vertcat(*own)])

    def tip(self) -> ca.Function:
        """Return the place (2,) of the tip by q."""
        q = ca.SX.sym('q', self.n)
        return ca.Function('tip', [q], [self._points(q, np.array([self.length]))[-1]])

    def _points(self, q: ca.SX, x: Array) -> list[ca.SX]:
        """Return the places (2,) of points at x (k,) of each link."""
        nodes, weights = leggauss(2 * POINTS)
        place, angle, found = ca.SX.zeros(2), ca.SX(0), []
        for link in range(self.links):
            angle, bend = angle + q[3 * link], q[3 * link + 1 : 3 * link + 3]
            across = ca.vertcat(-ca.sin(angle), ca.cos(angle))
            along = ca.vertcat(ca.cos(angle), ca.sin(angle))
            places = []
            for at in [*x, self.length]:
                slopes = self.shapes(0.5 * at * (nodes + 1.0), 1)
                shorter = 0.5 * at * (slopes * weights) @ slopes.T
                reach = at - 0.5 * ca.bilin(shorter, bend, bend)
                off = ca.dot(self.shapes(np.array([at]))[:, 0], bend)
                places.append(place + reach * along + off * across)
            found += places[:-1]
            place = places[-1]
            angle = angle + ca.dot(self.shapes(np.array([self.length]), 1)[:, 0], bend)
        return found


@dataclass(frozen=True)
class RestBeams:
    """Two postures of an arm, with limits, and perhaps a place that its tip passes between.

    Attributes
    ----------
    arm : Beams
    first, last : (links,) arrays
        Joints [rad].
    effort : (links,) array
        N m.
    modes : int
        How many rest at the end, from the lowest.
    curvature : float
        Largest of each link [1/m].
    via : (2,) array, optional
        Place [m] of the tip on the way, to be passed within `radius` [m].
    """

    arm: Beams
    first: Array
    last: Array
    effort: Array
    modes: int
    curvature: float = np.inf
    via: Array | None = None
    radius: float = 0.0

    def shortest(self, about: float, intervals: int = 40, middle: Array | None = None) -> float:
        """Return the least time [s].

        Parameters
        ----------
        about : float
            A time to begin with [s].
        intervals : int
            Of the motion; with a place on the way before it and after it.
        middle : (links,) array, optional
            Joints at the place on the way, to begin with.
        """
        n, joints = self.arm.n, np.arange(0, self.arm.n, 3)
        parts = 1 if self.via is None else 2
        count = parts * intervals
        states = ca.MX.sym('x', 2 * n, count + 1)
        inner, turns = ca.MX.sym('z', 2 * n * ORDER, count), ca.MX.sym('a', n * ORDER, count)
        durations = ca.MX.sym('T', parts)
        lengths = ca.horzcat(*(ca.repmat(durations[k], 1, intervals) for k in range(parts)))
        zero, kept = self._interval().map(count)(
            states[:, :-1], states[:, 1:], inner, turns, lengths / intervals
        )

        # begin with the rigid arm, by a polynomial
        share = np.linspace(0.0, 1.0, intervals + 1)
        way = ((3.0 - 2.0 * share) * share**2)[:, None]
        stops = [self.first, *([] if middle is None else [middle]), self.last]
        pieces = [a + (b - a) * way for a, b in itertools.pairwise(stops)]
        rows = np.zeros((2 * n, count + 1))
        rows[joints] = np.vstack([pieces[0], *(piece[1:] for piece in pieces[1:])]).T
        begin = [rows, np.tile(rows[:, :-1], (ORDER, 1)), np.zeros((n * ORDER, count))]
        unknowns = ca.vertcat(ca.vec(states), ca.vec(inner), ca.vec(turns), durations)
        start = np.concatenate([
            *(part.ravel('F') for part in begin),
            np.full(parts, about / parts),
        ])  # fmt: skip

        still, modal = self._equilibrium(self.last)
        elastic = np.setdiff1d(np.arange(n), joints).tolist()
        q, v = states[:n, -1], states[n:, -1]
        equal = ca.vertcat(
            ca.vec(zero),
            states[:n, 0] - self._equilibrium(self.first)[0],
            states[n:, 0],
            q[joints.tolist()] - self.last,
            v[joints.tolist()],
            modal @ (q[elastic] - still[elastic]),
            modal @ v[elastic],
        )
        limits = [ca.vec(kept)]
        if self.via is not None:
            off = (self.arm.tip()(states[:n, intervals]) - self.via) / self.radius
            limits.append(ca.dot(off, off))
        beyond = ca.vertcat(*limits)
        upper = np.concatenate([np.zeros(equal.shape[0]), np.ones(beyond.shape[0])])
        problem: dict[str, Any] = {
            'x': unknowns,
            'f': ca.sum1(durations) / about,
            'g': ca.vertcat(equal, beyond),
        }
        solver = ca.nlpsol('fastest', 'ipopt', problem, OPTIONS)
        least = np.full(len(start), -np.inf)
        least[-parts:] = 0.05 * about
        found = solver(x0=start, lbx=least, lbg=-upper, ubg=upper)
        if not solver.stats()['success']:
            raise RuntimeError(solver.stats()['return_status'])
        return float(np.sum(found['x'][-parts:]))

    def _interval(self) -> ca.Function:
        """Return what vanishes in an interval, and what is to be from -1 to 1.

        Of the states (q, q') before and after, those and q'' at the points within, and the
        interval's length.
        """
        n = self.arm.n
        forces = self.arm.forces()
        bends = self.arm.shapes(np.linspace(0.0, self.arm.length, STATIONS), 2).T
        slopes, ends, _ = ca.collocation_coeff(ca.collocation_points(ORDER, 'legendre'))
        before, after = ca.SX.sym('before', 2 * n), ca.SX.sym('after', 2 * n)
        inner, turns = ca.SX.sym('z', 2 * n, ORDER), ca.SX.sym('a', n, ORDER)
        length = ca.SX.sym('h')
        along = ca.horzcat(before, inner)
        rates = along @ slopes
        zero, kept = [after - along @ ends], []
        for j in range(ORDER):
            q, v, a = inner[:n, j], inner[n:, j], turns[:, j]
            zero.append(rates[:, j] - length * ca.vertcat(v, a))
            force = forces(q, v, a)
            for link in range(self.arm.links):
                elastic = slice(3 * link + 1, 3 * link + 3)
                zero.append(force[elastic] / self.arm.ei)
                kept.append(force[3 * link] / self.effort[link])
                if self.curvature < np.inf:
                    kept.append(bends @ q[elastic] / self.curvature)
        given = [before, after, ca.vec(inner), ca.vec(turns), length]
        return ca.Function('interval', given, [ca.vertcat(*zero), ca.vertcat(*kept)])

    def _equilibrium(self, joints: Array) -> tuple[Array, Array]:
        """Return the coordinates (n,) at rest, and modal amplitudes (modes, elastic) by these."""
        n, zero = self.arm.n, np.zeros(self.arm.n)
        forces = self.arm.forces()
        q, a = ca.SX.sym('q', n), ca.SX.sym('a', n)
        at = ca.Function('at', [q], [
            forces(q, zero, zero),
            ca.jacobian(forces(q, zero, zero), q),
            ca.jacobian(forces(q, zero, a), a),
        ])  # fmt: skip
        still = zero.copy()
        still[::3] = joints
        elastic = np.setdiff1d(np.arange(n), np.arange(0, n, 3))
        block = np.ix_(elastic, elastic)
        for _ in range(20):
            force, stiffness, inertia = (np.array(part) for part in at(still))
            still[elastic] -= np.linalg.solve(stiffness[block], force[elastic, 0])
        shapes = scipy.linalg.eigh(stiffness[block], inertia[block])[1][:, : self.modes]
        return still, shapes.T @ inertia[block]
