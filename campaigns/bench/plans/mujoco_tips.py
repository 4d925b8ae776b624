"""Tip-exact motions carried out by MuJoCo, whose beams are chains of rods without shapes.

python -m campaigns tips [--segments 32] [CASE ...]

Plans of `shape_motion(method='tip')`, once by their torque alone, open loop, and once with the
joints on the plan; the error of the tip while it moves and up to three seconds after.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from control_runs import ROBOTS, Reference, cycloid
from scipy.interpolate import CubicHermiteSpline, CubicSpline

import denoc_ros as dn
from denoc_ros.dynamics.driven.driven_motion import driven_motion
from denoc_ros.dynamics.driven.motion_plan import Plan
from denoc_ros.dynamics.robot import Robot
from denoc_ros.export.mujoco_robot import MujocoRobot, MujocoSettings
from denoc_ros.model.beams.segments import whole_beams
from denoc_ros.planning.tip.asked_motion import AskedMotion
from denoc_ros.simulation.simulated_robot import Drives
from denoc_ros.types import Array

STEP = 2e-3  # s
AFTER = 3.0  # s
SEGMENTS = 32
SHAPE, MODES = 'craig-bampton', 2


@dataclass(frozen=True)
class Case:
    """A motion that is asked of a robot."""

    name: str
    robot: Callable[[], Robot]
    motion: Reference
    duration: float
    by_torque: bool = True


@dataclass(frozen=True)
class Errors:
    """Errors of the tip [m]: root mean square while it moves, largest after."""

    moving: float
    after: float


def arm(
    name: str, gravity: tuple[float, float, float] = (0.0, 0.0, 0.0), modes: int = MODES
) -> Robot:
    """A shipped robot whose beams' tips turn rightly under a moment."""
    robot = dn.load_robot(ROBOTS / f'{name}.urdf', gravity=gravity)
    changes: dict[str, float | str] = {}
    for beam in whole_beams(robot.tree):
        changes[f'beam.{beam.link}.shape'] = SHAPE
        for part in ('y', 'z'):
            if getattr(beam.segment, part) is not None:
                changes[f'beam.{beam.link}.{part}.modes'] = modes
    return robot.with_overrides(changes)


def hidden(seed: int, joints: int, size: float) -> Reference:
    """A motion between two postures that nobody chose."""
    rng = np.random.default_rng(seed)
    start = rng.uniform(-1.0, 1.0, joints)
    return cycloid(start, start + size * rng.uniform(-1.0, 1.0, joints), 10.0)


def cases() -> list[Case]:
    """Return all motions."""
    way = cycloid(np.radians([10.0, 40.0, 30.0]), np.radians([60.0, 45.0, 30.0]), 10.0)
    regular = np.array([0.2, 0.5, -0.9, 0.4, 0.3, 0.2])
    gravity = (0.0, -9.81, 0.0)
    found = [Case('Canadarm', lambda: arm('canadarm'), way, 10.0)]
    for seed in (1, 2, 3):
        found.append(
            Case(f'Canadarm, hidden {seed}', lambda: arm('canadarm'), hidden(seed, 3, 1.0), 10.0)
        )
    return [
        *found,
        Case('Canadarm, 4 modes', lambda: arm('canadarm', modes=4), way, 10.0),
        Case('SSRMS', lambda: arm('ssrms'), cycloid(regular, regular + 0.5, 20.0), 20.0),
        Case(
            'two links, gravity', lambda: arm('two_link_ff', gravity),
            cycloid(np.array([-1.2, 0.4]), np.array([-0.6, -0.3]), 3.0), 3.0, by_torque=False,
        ),
        Case('Canadarm on 10 t', lambda: arm('canadarm_10t'), way, 10.0),
    ]  # fmt: skip


def plan_of(case: Case, robot: Robot) -> tuple[Plan, Array, Array]:
    """Return the plan, and the motion that was asked."""
    times = np.linspace(0.0, case.duration, round(50 * case.duration) + 1)
    rows = case.motion(times)
    return dn.shape_motion(robot, times, rows, tip='tool'), times, rows


def carried_out(
    robot: Robot, plan: Plan, times: Array, rows: Array, by_torque: bool, segments: int = SEGMENTS
) -> Errors:
    """Carry a plan out in MuJoCo."""
    motion = driven_motion(robot)
    still = np.zeros(len(motion.joints))
    drives = Drives(motion.given, motion.index, still, still)
    falls = len(robot.base_indices) > 0 or not robot.gravity.any()
    settings = MujocoSettings(segments, static=not falls)
    there = MujocoRobot(robot, robot.tree, STEP, plan.q[0], drives, settings)
    torque = CubicSpline(plan.t, plan.torque)
    rates = CubicHermiteSpline(plan.t, plan.qd[:, motion.index], plan.qdd[:, motion.index])
    begin, end = float(plan.t[0]), float(plan.t[-1])
    count = round((end + AFTER - begin) / STEP)
    tips, tau = np.zeros((count, 3)), np.zeros(robot.n)
    for k in range(count):
        now = begin + k * STEP
        if by_torque:
            tau[motion.index] = torque(min(now + 0.5 * STEP, end))
            there.free(tau)
        else:
            wanted = rates(min(now + STEP, end))
            there.drive((wanted - there.qd[motion.index]) / STEP)
        tips[k] = there.data.site('tool').xpos
    t: Array = np.asarray(begin + STEP * np.arange(1, count + 1), dtype=np.float64)
    wanted = AskedMotion(robot, times, rows).poses('tool', t)[:, :3, 3]
    error = np.linalg.norm(tips - wanted, axis=1)
    moving = t <= times[-1]
    return Errors(float(np.sqrt(np.mean(error[moving] ** 2))), float(error[~moving].max()))


def main() -> None:
    """Print a row for each case."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--segments', type=int, default=SEGMENTS)
    parser.add_argument('cases', nargs='*')
    args = parser.parse_args()
    print('| motion | torque alone: moving rms / after [mm] | joints on the plan |\n|---|---|---|')
    for case in cases():
        if args.cases and case.name not in args.cases:
            continue
        robot = case.robot()
        plan, times, rows = plan_of(case, robot)
        cells = []
        for by_torque in (True, False):
            if by_torque and not case.by_torque:
                cells.append('falls')
                continue
            found = carried_out(robot, plan, times, rows, by_torque, args.segments)
            cells.append(f'{1e3 * found.moving:.2f} / {1e3 * found.after:.2f}')
        print(f'| {case.name} | {cells[0]} | {cells[1]} |', flush=True)


if __name__ == '__main__':
    main()
