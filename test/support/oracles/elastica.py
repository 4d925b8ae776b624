"""A cantilever against the elastica, which knows no small deflections."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from segmented_robots import strip

from denoc_ros.dynamics.robot import Robot, load_robot
from denoc_ros.types import Array

LOADS = ('force', 'moment')
# of a cantilever of length 1 m and EI 1 N m^2: force in N, moment in N m
SIZES = {
    'force': (0.15, 0.3, 0.6, 0.95, 1.27, 1.63, 2.0),
    'moment': (0.1, 0.2, 0.4, 0.62, 0.85, 1.1, 1.3),
}


@dataclass(frozen=True)
class Tip:
    """Where a tip is (x, y) [m], and how it has turned [rad]."""

    x: float
    y: float
    angle: float


def elastica(load: str, size: float) -> Tip:
    """Return the tip of the inextensible cantilever under a load that keeps its direction.

    Notes
    -----
    theta'' = -F cos(theta), theta(0) = 0, theta'(1) = 0 for a transverse force F; a circle for
    a moment.
    """
    if load == 'moment':
        return Tip(np.sin(size) / size, (1.0 - np.cos(size)) / size, size)

    def end(curvature: float) -> Array:
        run = solve_ivp(
            lambda _, z: [z[1], -size * np.cos(z[0]), np.cos(z[0]), np.sin(z[0])],
            (0.0, 1.0),
            [0.0, curvature, 0.0, 0.0],
            rtol=1e-11,
            atol=1e-13,
        )
        return np.asarray(run.y[:, -1])

    # the arm of the force is at most the length
    angle, _, x, y = end(brentq(lambda curvature: end(curvature)[1], 0.0, 1.001 * size))
    return Tip(x, y, angle)


@cache
def cantilever(geometric_stiffness: bool, shape: str = 'craig-bampton', modes: int = 2) -> Robot:
    """Return the clamped beam; two Craig-Bampton shapes are a cantilever's exact static ones."""
    return load_robot(
        f"""<robot name="cantilever"><link name="base"/><link name="tip"/><link name="beam">
        <inertial><origin xyz="0.5 0 0"/><mass value="0.12"/>
        <inertia ixx="0" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/></inertial></link>
        <joint name="clamp" type="fixed"><parent link="base"/><child link="beam"/></joint>
        <joint name="end" type="fixed"><parent link="beam"/><child link="tip"/>
        <origin xyz="1 0 0"/></joint><flexibility><beam link="beam" length="1" shape="{shape}">
        <bending direction="y" ei="1" modes="{modes}"/></beam></flexibility></robot>""",
        gravity=(0.0, 0.0, 0.0),
        geometric_stiffness=geometric_stiffness,
    )


def model(robot: Robot, load: str, size: float) -> Tip:
    """Return the model's tip in equilibrium."""
    wrench = np.zeros(6)
    wrench[1 if load == 'force' else 5] = size
    q = robot.static_deflection(np.zeros(0), wrenches={'tip': wrench})
    pose = robot.frame_pose('tip', q)
    return Tip(pose[0, 3], pose[1, 3], float(np.arctan2(pose[1, 0], pose[0, 0])))


def distance(a: Tip, b: Tip) -> float:
    """Return how far apart two tips are [m]."""
    return float(np.hypot(a.x - b.x, a.y - b.y))


def rows(load: str) -> Array:
    """Return, per size of a load: the true deflection, the model's error with foreshortening and
    without, all as shares of the length, and the error of the slope [rad], (k, 4).
    """
    found = []
    for size in SIZES[load]:
        truth = elastica(load, size)
        full, without = (model(cantilever(stiff), load, size) for stiff in (True, False))
        errors = distance(full, truth), distance(without, truth)
        found.append((truth.y, *errors, abs(full.angle - truth.angle)))
    return np.array(found)


def divided_table() -> str:
    """Return the table of docs/theory.md of links of segments."""
    counts = (1, 2, 4, 8, 16)
    lines = [
        f'| deflection of the tip | {" | ".join(f"{k} segments" for k in counts)} |'.replace(
            ' 1 segments', ' 1 segment'
        ),
        f'|{"---|" * (1 + len(counts))}',
    ]
    for size in SIZES['force'][1:]:
        truth = elastica('force', size)
        off = [distance(model(strip(k), 'force', size), truth) for k in counts]
        cells = [f'{100 * truth.y:.1f} %', *(f'{100 * value:.2g} %' for value in off)]
        lines.append(f'| {" | ".join(cells)} |')
    return '\n'.join(lines)


def table() -> str:
    """Return the table of docs/theory.md."""
    lines = [
        '| deflection of the tip | force: error | without foreshortening | slope error '
        '| moment: deflection | error | without foreshortening |',
        '|---|---|---|---|---|---|---|',
    ]
    for force, moment in zip(rows('force'), rows('moment'), strict=True):
        cells = [
            f'{100 * force[0]:.1f} %',
            *(f'{100 * value:.2g} %' for value in force[1:3]),
            f'{np.degrees(force[3]):.2g}°',
            f'{100 * moment[0]:.1f} %',
            *(f'{100 * value:.2g} %' for value in moment[1:3]),
        ]
        lines.append(f'| {" | ".join(cells)} |')
    return '\n'.join(lines)
