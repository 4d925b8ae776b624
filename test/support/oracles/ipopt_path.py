"""Least times of planar arms with flexible links whose tip keeps to a path, by CasADi and IPOPT.

The model and the collocation are those of rest_by_ipopt. The place along the path and its rate
are states, its acceleration is free at each point, and the tip's acceleration is the path's there:
the tip is as exact as the collocation.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from ipopt_rest import OPTIONS, ORDER, STATIONS, RestBeams
from scipy.interpolate import BSpline, CubicHermiteSpline

STILL = 14  # intervals of the time before, and of that after
# the search begins with a good motion: with the barrier's usual start it does not settle
NEAR = {'tol': 1e-4, 'acceptable_tol': 1e-3, 'mu_init': 1e-4}
COARSE: dict[str, Any] = {**OPTIONS, 'ipopt': {**OPTIONS['ipopt'], **NEAR}}


@dataclass(frozen=True)
class PathBeams(RestBeams):
    """A way between two postures; an undeformed arm's joints would be on a line. No gravity.

    Attributes
    ----------
    windows : (before, after)
        How long the joints may move while the tip stands [s].
    """

    windows: tuple[float, float] = (0.0, 0.0)

    def along(
        self, known: BSpline, about: float, intervals: int
    ) -> tuple[float, CubicHermiteSpline]:
        """Return the least time of the passage [s], and the place, 0 to 1, by time.

        The search begins with a motion that takes `about` seconds: its coordinates and its place
        along the path (n + 1,) by time from the beginning of the passage on.
        """
        n, count, duration = self.arm.n + 1, intervals + 2 * STILL, ca.MX.sym('T')
        lengths = ca.horzcat(
            ca.repmat(self.windows[0] / STILL, 1, STILL),
            ca.repmat(duration / intervals, 1, intervals),
            ca.repmat(self.windows[1] / STILL, 1, STILL),
        )
        steps = np.array(ca.Function('lengths', [duration], [lengths])(about)).ravel()
        nodes = np.append(0.0, np.cumsum(steps)) - self.windows[0]
        within = nodes[:-1] + np.outer(ca.collocation_points(ORDER, 'legendre'), steps)
        q, v, a = (np.moveaxis(known(within, k), 2, 1) for k in range(3))
        begin = [
            np.concatenate([known(nodes), known(nodes, 1)], axis=1).T,
            np.concatenate([q, v], axis=1).reshape(-1, count),
            a.reshape(-1, count),
        ]
        parts = [ca.MX.sym('x', *each.shape) for each in begin]
        states, inner, turns = parts
        zero, kept = self._passage().map(count)(
            states[:, :-1], states[:, 1:], inner, turns, lengths
        )
        rest = np.zeros((2, 2 * n))
        rest[:, : n - 1 : 3], rest[:, n - 1] = (self.first, self.last), (0.0, 1.0)
        # links at rest and the place say where the joints are at the end
        ends = np.setdiff1d(np.arange(2 * n), [*range(0, n - 1, 3), *range(n, 2 * n - 1, 3)])
        moving = turns[n - 1 :: n, :]
        equal = ca.vertcat(
            ca.vec(zero),
            states[:, 0] - rest[0],
            states[ends.tolist(), -1] - rest[1][ends],
            ca.vec(moving[:, :STILL]),
            ca.vec(moving[:, -STILL:]),
        )
        upper = np.concatenate([np.zeros(equal.shape[0]), np.ones(kept.numel())])
        problem: dict[str, Any] = {
            'x': ca.vertcat(*map(ca.vec, parts), duration),
            'f': duration / about,
            'g': ca.vertcat(equal, ca.vec(kept)),
        }
        solver = ca.nlpsol('fastest', 'ipopt', problem, COARSE)
        start = np.append(np.concatenate([each.ravel('F') for each in begin]), about)
        least = np.full(len(start), -np.inf)
        least[-1] = 0.05 * about
        found = solver(x0=start, lbx=least, lbg=-upper, ubg=upper)
        if not solver.stats()['success']:
            raise RuntimeError(solver.stats()['return_status'])
        x = np.array(found['x']).ravel()
        times = np.linspace(0.0, x[-1], intervals + 1)
        nodes = x[: states.numel()].reshape(count + 1, 2 * n)[STILL : STILL + intervals + 1]
        return float(x[-1]), CubicHermiteSpline(times, nodes[:, n - 1], nodes[:, -1])

    def _passage(self) -> ca.Function:
        """Return what vanishes in an interval, and what is to be from -1 to 1.

        Of the states (q, s, q', s') before and after, those and the accelerations at the points
        within, and the interval's length.
        """
        n, tip, forces = self.arm.n, self.arm.tip(), self.arm.forces()
        bends = self.arm.shapes(np.linspace(0.0, self.arm.length, STATIONS), 2).T
        slopes, ends, _ = ca.collocation_coeff(ca.collocation_points(ORDER, 'legendre'))
        y, dy, ddy = (ca.SX.sym(name, n + 1) for name in ('y', 'dy', 'ddy'))
        stiff = ca.SX.zeros(n)
        stiff[::3] = self.first + y[n] * (self.last - self.first)
        off = tip(y[:n]) - tip(stiff)
        rate = ca.jtimes(off, y, dy)
        turned = ca.jtimes(rate, y, dy) + ca.jtimes(rate, dy, ddy)
        leaves = ca.Function('leaves', [y, dy, ddy], [turned])
        size = 2 * (n + 1)
        before, after = ca.SX.sym('before', size), ca.SX.sym('after', size)
        inner, turns = ca.SX.sym('z', size, ORDER), ca.SX.sym('a', n + 1, ORDER)
        length = ca.SX.sym('h')
        along = ca.horzcat(before, inner)
        rates = along @ slopes
        zero, kept = [after - along @ ends], []
        for j in range(ORDER):
            here, moves, a = inner[: n + 1, j], inner[n + 1 :, j], turns[:, j]
            zero += [rates[:, j] - length * ca.vertcat(moves, a), leaves(here, moves, a) / 10.0]
            force = forces(here[:n], moves[:n], a[:n])
            for link in range(self.arm.links):
                elastic = slice(3 * link + 1, 3 * link + 3)
                zero.append(force[elastic] / self.arm.ei)
                kept.append(force[3 * link] / self.effort[link])
                if self.curvature < np.inf:
                    kept.append(bends @ here[elastic] / self.curvature)
        given = [before, after, ca.vec(inner), ca.vec(turns), length]
        return ca.Function('passage', given, [ca.vertcat(*zero), ca.vertcat(*kept)])
