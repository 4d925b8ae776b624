"""What tip-exact motions reach and cost: the figures of docs/control.md.

taskset -c 0 .venv/bin/python -m campaigns plans
"""

from __future__ import annotations

import resource
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from control_runs import ROBOTS, Reference, carried_out, cycloid
from panda_strip import SIDE, panda_strip

import denoc_ros as dn
from denoc_ros.dynamics.driven.motion_plan import Plan
from denoc_ros.planning.plan_simulation import carry_out, planned
from denoc_ros.planning.tip.asked_motion import AskedMotion
from denoc_ros.simulation.reference_motion import Circle, follow
from denoc_ros.types import Array

CIRCLE = Circle('tool', np.array([0.25, 0.1443, 0.0]), 0.06, 1.0)
NEAR = (1.092, -1.629, 1.0605987755982988, 3.307, -2.291, 4.198, 1.938)
LEGS = ('joint_11', 'joint_12', 'joint_13')
REGULAR = np.array([0.2, 0.5, -0.9, 0.4, 0.3, 0.2])
MB = 1e3  # kB


@dataclass(frozen=True)
class Case:
    """A robot and the motion that is asked of it."""

    name: str
    robot: dn.Robot
    duration: float
    motion: Reference
    frame: str = 'tool'
    by_torque: bool = True  # else with the joints on the plan: some arms fall from rest


def eq_3_56(t: Array) -> Array:
    """Return the book's motion of the Canadarm, from straight to rest, at times (k,)."""
    at, rate = np.clip(t, 0.0, 20.0)[:, None], np.array([0.075, 0.05, 0.1])
    period = np.array([10.0, 5.0, 5.0])
    return np.asarray(rate * (at - period / np.pi * np.sin(np.pi * at / period)))


def waving(duration: float) -> Reference:
    """Return a long motion of seven joints that swells from rest and dies down."""
    rates = 0.1 * np.pi * np.arange(1, 8)

    def sample(t: Array) -> Array:
        at = np.clip(t, 0.0, duration)[:, None]
        envelope = np.sin(np.pi * at / duration) ** 2
        return np.asarray(np.array(SIDE) + 0.3 * envelope * np.sin(rates * at))

    return sample


def loaded(name: str, gravity: float, payload: float = 0.0) -> dn.Robot:
    robot = dn.load_robot(ROBOTS / f'{name}.urdf', gravity=(0, 0, gravity))
    if payload:
        robot.set_payload('tool', payload)
    return robot


def cases() -> list[Case]:
    """Return all open arms."""
    canadarm = cycloid(np.radians([10.0, 40.0, 30.0]), np.radians([60.0, 45.0, 30.0]), 10.0)
    spatial = cycloid(REGULAR, REGULAR + 0.5, 20.0)
    straight = cycloid(np.zeros(6), np.full(6, 0.5), 10.0)
    return [
        Case('Canadarm', loaded('canadarm', 0.0), 10.0, canadarm),
        Case('Canadarm, eq. 3.56', loaded('canadarm', 0.0), 20.0, eq_3_56),
        Case('SSRMS', loaded('ssrms', 0.0), 20.0, spatial),
        Case('SSRMS, 100 kg', loaded('ssrms', 0.0, 100.0), 20.0, spatial),
        Case('SSRMS, 1.62 m/s^2', loaded('ssrms', -1.62), 20.0, spatial, by_torque=False),
        Case(
            'SSRMS, 1.62 m/s^2, 100 kg', loaded('ssrms', -1.62, 100.0), 20.0, spatial,
            by_torque=False,
        ),
        Case('SSRMS, from straight', loaded('ssrms', 0.0), 10.0, straight),
        Case('Canadarm on 10 t', loaded('canadarm_10t', 0.0), 10.0, canadarm),
        Case('Canadarm on 100 t', loaded('canadarm_100t', 0.0), 10.0, canadarm),
        Case('SSRMS on 10 t', loaded('ssrms_10t', 0.0), 20.0, spatial),
        Case('SSRMS on 10 t, from straight', loaded('ssrms_10t', 0.0), 10.0, straight),
        Case('Panda with a strip', panda_strip(), 30.0, waving(30.0), 'strip_tip', False),
        Case('Panda with a strip', panda_strip(), 120.0, waving(120.0), 'strip_tip', False),
    ]  # fmt: skip


def timed(make: Callable[[], Plan]) -> tuple[Plan, float]:
    """Return a plan and the processor time [s] that it took, kernels ready."""
    make()
    began = time.process_time()
    plan = make()
    return plan, time.process_time() - began


def show(name: str, plan: Plan, duration: float, cost: float, error: Array, moving: Any) -> None:
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / MB
    after = 1e3 * error[~moving].max(initial=0.0)
    inside = error[moving]
    print(
        f'| {name} | {duration:g} | {1e3 * inside.max():.4f} | '
        f'{1e3 * np.sqrt(np.mean(inside**2)):.4f} | {after:.4f} | '
        f'{plan.preaction:.2f} | {plan.stretch:.3g} | {100.0 * cost / duration:.2f} | '
        f'{memory:.0f} |',
        flush=True,
    )


def run(case: Case) -> None:
    """Plan, carry out and print one row."""
    robot, duration = case.robot, case.duration
    times = np.linspace(0.0, duration, round(50 * duration) + 1)
    # what SSRMS holds against gravity is more than its 5000 N m
    bound: dict[str, Any] = {'effort': 1e5} if 'm/s^2' in case.name else {}
    rows = case.motion(times)
    plan, cost = timed(lambda: dn.shape_motion(robot, times, rows, tip=case.frame, **bound))
    if case.by_torque:
        done = carried_out(robot, plan, after=3.0)
        t, q = done.t, done.q
    else:
        t = np.linspace(plan.t[0], plan.t[-1] + 3.0, 2000)
        motion = planned(plan, plan.joint_names)
        q = carry_out(robot, motion, plan.joint_names, plan.q[0], t).q
    wanted = AskedMotion(robot, times, rows).poses(case.frame, t)
    apart = robot.frame_pose(case.frame, q) - wanted
    error = np.linalg.norm(apart[:, :3, 3], axis=1)
    name = case.name if case.by_torque else f'{case.name} (joints)'
    show(name, plan, duration, cost, error, t <= duration)


def platform() -> None:
    """Print the row of the platform of section 5.5 on its circle, by torque alone."""
    rigid, robot = (
        dn.load_robot(ROBOTS / f'planar_3dof_{legs}.urdf', gravity=(0, -9.81, 0))
        for legs in ('3rr', '3ff')
    )
    times, joints, _, _ = follow(rigid, CIRCLE, rigid.assemble(np.array(NEAR))).table(0.005)
    plan, cost = timed(lambda: dn.shape_motion(robot, times, joints, joints=LEGS))
    done = carried_out(robot, plan, after=0.0, step=0.005)
    wanted = np.array([CIRCLE.sample(float(np.clip(t, 0.0, 1.0)))[0] for t in done.t])
    error = np.linalg.norm(robot.frame_pose('tool', done.q)[:, :3, 3] - wanted, axis=1)
    show('3FF platform', plan, 1.0, cost, error, done.t <= 1.0)


def five_bar() -> None:
    """Print the row of the five-bar mechanism, by torque alone."""
    rigid, robot = (
        dn.load_robot(ROBOTS / f'five_bar_{kind}.urdf', gravity=(0, -9.81, 0))
        for kind in ('rrrr', 'ffff')
    )
    start = rigid.assemble(np.array([1.884956, -1.256637, 1.256637, 1.256637]))
    times, driven = np.linspace(0.0, 2.0, 401), ['joint_1', 'joint_3']
    joints = np.tile(start, (len(times), 1))
    joints[:, [0, 2]] = cycloid(start[[0, 2]], start[[0, 2]] - [0.5, 0.2], 2.0)(times)
    joints = np.array([rigid.assemble(row, fixed=driven) for row in joints])
    frame = 'joint_5/parent'
    plan, cost = timed(lambda: dn.shape_motion(robot, times, joints, tip=frame, joints=driven))
    done = carried_out(robot, plan, after=0.0)
    at = rigid.frame_pose(frame, joints)[:, :3, 3]
    wanted = np.stack([np.interp(done.t, times, column) for column in at.T], axis=1)
    error = np.linalg.norm(robot.frame_pose(frame, done.q)[:, :3, 3] - wanted, axis=1)
    show('five-bar FFFF', plan, 2.0, cost, error, done.t <= 2.0)


def main() -> None:
    """Print the table."""
    print(
        '| motion | s | moving, largest [mm] | rms [mm] | after [mm] | preaction [s] | stretch | '
        'processor time [% of it] | memory so far [MB] |\n' + '|---' * 9 + '|'
    )
    for case in cases():
        run(case)
    platform()
    five_bar()


if __name__ == '__main__':
    main()
