"""Second-order displacement of a link: modal derivatives, or foreshortening along its line.

Without it a link that spins is too soft, and the more the faster it spins.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from denoc_ros.reduction.body import FiniteElementBody, Rows
from denoc_ros.reduction.craig_bampton import Craigs, Report
from denoc_ros.reduction.elements import Solid
from denoc_ros.types import Array

SHARED = 1.0 / 3.0  # of a second derivative's part within the modes: see Notes
NEGLIGIBLE = 1e-3  # of the largest pair, at amplitudes of equal energy


@dataclass(frozen=True)
class Quadratic:
    """Gamma_jk of pairs of modes.

    `pairs` (g, 2), j <= k; `nodes` (n, 3, g); `frames` (3, g) of each outer frame, in order.
    """

    pairs: Rows
    nodes: Array
    frames: list[Array]
    kind: str

    @classmethod
    def none(cls, body: FiniteElementBody, frames: int) -> Quadratic:
        """Return one without terms."""
        empty = np.zeros((0, 2), dtype=np.int64)
        zeros = [np.zeros((3, 0))] * frames
        return cls(empty, np.zeros((len(body.places), 3, 0)), zeros, 'none')


def modal_derivatives(
    solid: Solid, craigs: Craigs, coordinates: Array, stiffness: Array, report: Report
) -> Quadratic:
    """Second derivatives of the static displacement with respect to the modes' amplitudes.

    Parameters
    ----------
    solid : Solid
        The elements of the body.
    coordinates : ndarray (6 F + k, m)
        The modes.
    stiffness : ndarray (m,)
    report : callable
        Takes the share of the work that is done.

    Notes
    -----
    With the internal force f(u), K Gamma_jk = -d^2 f / (d d_j d d_k) (Idelsohn, Cardona, Comput.
    Meth. Appl. Mech. Eng. 49, 1985); a rigid patch turns to the second order as rigid bodies do.
    With the whole solution, the strain energy would have a cubic term -T(d, d, d) / 3, where
    T_ijk = phi_i . f_jk, and T / 6 without its part within the modes; with a third of that part
    it has none, and the diagonal stiffness is exact to the third order.
    """
    body = craigs.body
    modes = body.displacement(craigs.expand(coordinates))
    count = modes.shape[2]
    moved = coordinates[: craigs.outer]
    pairs = [(j, k) for j in range(count) for k in range(j, count)]
    nodes, frames = [], []
    for at, (j, k) in enumerate(pairs):
        force = body.values(solid.quadratic_force(modes[:, :, j], modes[:, :, k]))
        prescribed = np.zeros(len(force))
        for f, (rows, _) in enumerate(craigs.ties[1:]):
            turns = moved[6 * f + 3 : 6 * f + 6]
            arm = body.nodes[body.dof_nodes[rows]] - craigs.patches[f + 1].origin
            second = turned_twice(turns[:, j], turns[:, k], arm)
            prescribed[rows] = second[np.arange(len(rows)), body.dof_axes[rows]]
        values, outer = craigs.respond(-force, prescribed)
        found = body.displacement(values)
        # K-orthogonal parts: phi_i . K Gamma = -T_ijk
        inside = -np.einsum('nai,na->i', modes, body.displacement(force)) / stiffness
        found -= (1.0 - SHARED) * modes @ inside
        outer = outer - (1.0 - SHARED) * moved @ inside
        nodes.append(found)
        frames.append(outer.reshape(-1, 6)[:, :3])
        report((at + 1) / len(pairs))
    nodes_found, frames_found = np.stack(nodes, axis=2), np.stack(frames, axis=2)
    return _kept(pairs, nodes_found, frames_found, stiffness, body, 'derivatives')


def foreshortening(
    body: FiniteElementBody,
    craigs: Craigs,
    coordinates: Array,
    stiffness: Array,
) -> Quadratic:
    """Second-order displacement of a slender link whose slices across its line stay rigid.

    Parameters
    ----------
    coordinates : ndarray (6 F + k, m)
        The modes.
    stiffness : ndarray (m,)

    Notes
    -----
    Slices turn by theta(x), found from their nodes by least squares. The line keeps its length:
    a point at rho from it moves along it by -1/2 int theta_across^2 dx, and by the second-order
    part of the turn, 1/2 theta x (theta x rho).
    """
    root, tip = body.line(craigs.patches)
    line = (tip - root) / np.linalg.norm(tip - root)
    modes = body.displacement(craigs.expand(coordinates))
    along = (body.places - root) @ line
    stations, turns, centres = [], [], []
    for inside in body.slices(along):
        centre = body.places[inside].mean(axis=0)
        stations.append(float(along[inside].mean()))
        centres.append(centre)
        turns.append(_turn(body.places[inside] - centre, modes[inside]))
    x = np.array(stations)
    turn = np.stack(turns)  # (s, 3, m)
    across = turn - np.einsum('a,b,sbm->sam', line, line, turn)
    count = turn.shape[2]
    pairs = [(j, k) for j in range(count) for k in range(j, count)]
    points = np.vstack([body.places, *(patch.origin[None] for patch in craigs.patches[1:])])
    along = (points - root) @ line
    at_points = _interpolated(x, turn, along)
    arm = points - _interpolated(x, np.stack(centres), along)
    found = []
    for j, k in pairs:
        rate = np.einsum('sa,sa->s', across[:, :, j], across[:, :, k])
        second = turned_twice(at_points[:, :, j], at_points[:, :, k], arm)
        found.append(second - _integral(x, rate, along)[:, None] * line)
    nodes, frames = np.split(np.stack(found, axis=2), [len(body.places)])
    return _kept(pairs, nodes, frames, stiffness, body, 'line')


def turned_twice(first: Array, second: Array, arm: Array) -> Array:
    """Return the second derivative (..., 3) of a turned arm along two turns [rad]."""
    return 0.5 * (np.cross(first, np.cross(second, arm)) + np.cross(second, np.cross(first, arm)))


def _kept(
    pairs: list[tuple[int, int]],
    nodes: Array,
    frames: Array,
    stiffness: Array,
    body: FiniteElementBody,
    kind: str,
) -> Quadratic:
    """Return the pairs that matter where each mode holds the same energy."""
    weight = np.array([1.0 / np.sqrt(stiffness[j] * stiffness[k]) for j, k in pairs])
    squares = sum(np.einsum('ng,ng->g', nodes[:, a], body.measure @ nodes[:, a]) for a in range(3))
    size = np.sqrt(np.maximum(squares, 0.0)) * weight
    kept = np.flatnonzero(size > NEGLIGIBLE * size.max(initial=0.0))
    return Quadratic(
        np.array([pairs[at] for at in kept], dtype=np.int64).reshape(-1, 2),
        nodes[:, :, kept],
        [frame[:, kept] for frame in frames],
        kind,
    )


def _turn(arm: Array, moved: Array) -> Array:
    """Return the turn (3, m) of nodes (n, 3) about their centre by least squares."""
    spread = np.eye(3) * np.einsum('na,na->', arm, arm) - arm.T @ arm
    moment = np.cross(arm[:, :, None], moved, axisa=1, axisb=1, axisc=1).sum(axis=0)
    return np.asarray(np.linalg.lstsq(spread, moment, rcond=1e-9)[0])


def _interpolated(x: Array, values: Array, at: Array) -> Array:
    """Return values (s, ...) between stations, linear beyond the last ones too."""
    shape = values.shape[1:]
    flat = values.reshape(len(x), -1)
    place = np.clip(np.searchsorted(x, at) - 1, 0, len(x) - 2)
    share = ((at - x[place]) / (x[place + 1] - x[place]))[:, None]
    return ((1.0 - share) * flat[place] + share * flat[place + 1]).reshape(len(at), *shape)


def _integral(x: Array, rate: Array, at: Array) -> Array:
    """Return the integral of a piecewise linear rate from the line's root, x = 0."""
    grid = np.unique(np.concatenate([x, [0.0, at.min(), at.max()]]))
    value = _interpolated(x, rate[:, None], grid)[:, 0]
    total = np.concatenate([[0.0], np.cumsum(0.5 * np.diff(grid) * (value[1:] + value[:-1]))])
    total -= np.interp(0.0, grid, total)
    place = np.clip(np.searchsorted(grid, at) - 1, 0, len(grid) - 2)
    step = at - grid[place]
    slope = (value[place + 1] - value[place]) / (grid[place + 1] - grid[place])
    return np.asarray(total[place] + step * (value[place] + 0.5 * step * slope))
