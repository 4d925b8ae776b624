"""Least times of planar arms with flexible links whose tip keeps to a path, by CasADi and IPOPT.

The model and the collocation are those of rest_by_ipopt. The place along the path is free at each
point, and so is the tip within a tolerance about where the undeformed arm's is there.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from rest_by_ipopt import OPTIONS, ORDER, RestBeams
from scipy.interpolate import BSpline

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
    tolerance : float
        Of the tip in either direction [m].
    """

    windows: tuple[float, float] = (0.0, 0.0)
    tolerance: float = 1e-4

    def along(self, known: BSpline, about: float, intervals: int) -> float:
        """Return the least time of the passage [s].

        The search begins with a motion that takes `about` seconds: its coordinates and its place
        along the path (n + 1,) by time from the beginning of the passage on.
        """
        n, still = self.arm.n, intervals
        count, duration = intervals + 2 * still, ca.MX.sym('T')
        lengths = ca.horzcat(
            ca.repmat(self.windows[0] / still, 1, still),
            ca.repmat(duration / intervals, 1, intervals),
            ca.repmat(self.windows[1] / still, 1, still),
        )
        steps = np.array(ca.Function('lengths', [duration], [lengths])(about)).ravel()
        nodes = np.append(0.0, np.cumsum(steps)) - self.windows[0]
        within = nodes[:-1] + np.outer(ca.collocation_points(ORDER, 'legendre'), steps)
        q, v, a = (np.moveaxis(known(within, k), 2, 1) for k in range(3))
        begin = [
            np.concatenate([known(nodes)[:, :n], known(nodes, 1)[:, :n]], axis=1).T,
            np.concatenate([q[:, :n], v[:, :n]], axis=1).reshape(-1, count),
            a[:, :n].reshape(-1, count),
            np.clip(q[:, n], 0.0, 1.0),
        ]
        parts = [ca.MX.sym('x', *each.shape) for each in begin]
        states, inner, turns, places = parts
        zero, kept = self._interval().map(count)(
            states[:, :-1], states[:, 1:], inner, turns, lengths
        )
        off = self._off().map(count)(inner, places)
        rest = np.zeros((2, 2 * n))
        rest[:, :n:3] = self.first, self.last
        equal = ca.vertcat(ca.vec(zero), states[:, 0] - rest[0], states[:, -1] - rest[1])
        beyond = ca.vertcat(ca.vec(kept), ca.vec(off))
        upper = np.concatenate([np.zeros(equal.shape[0]), np.ones(beyond.shape[0])])
        least, most = np.zeros((2, ORDER, count))
        least[:, -still:] = most[:, still:] = 1.0  # the tip stands in the windows
        free = np.full(sum(each.size for each in begin[:3]), np.inf)
        problem: dict[str, Any] = {
            'x': ca.vertcat(*map(ca.vec, parts), duration),
            'f': duration / about,
            'g': ca.vertcat(equal, beyond),
        }
        solver = ca.nlpsol('fastest', 'ipopt', problem, COARSE)
        found = solver(
            x0=np.append(np.concatenate([each.ravel('F') for each in begin]), about),
            lbx=np.concatenate([-free, least.ravel('F'), [0.05 * about]]),
            ubx=np.concatenate([free, most.ravel('F'), [np.inf]]),
            lbg=-upper,
            ubg=upper,
        )
        if not solver.stats()['success']:
            raise RuntimeError(solver.stats()['return_status'])
        return float(found['x'][-1])

    def _off(self) -> ca.Function:
        """Return how far the tip is off its place at an interval's points, over the tolerance."""
        n, tip = self.arm.n, self.arm.tip()
        inner, places = ca.SX.sym('z', 2 * n * ORDER), ca.SX.sym('s', ORDER)
        found = []
        for j in range(ORDER):
            stiff = ca.SX.zeros(n)
            stiff[::3] = self.first + places[j] * (self.last - self.first)
            found.append(tip(inner[2 * n * j : 2 * n * j + n]) - tip(stiff))
        return ca.Function('off', [inner, places], [ca.vertcat(*found) / self.tolerance])
