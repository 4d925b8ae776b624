"""Derivatives of the dynamics: rigid chains and the SSRMS beside Pinocchio, and their growth."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from book.benchmarks.growth import Made, slope_lines
from book.benchmarks.peers import Pinocchio, flexible_chain, rigid_chain
from book.benchmarks.results import BenchCheck, BenchLine, Reach
from book.benchmarks.rigid import (
    SIZES,
    State,
    conditioned,
    driven,
    pair,
    random_states,
)
from book.benchmarks.timing import Effort, Subject, compare, ratio

from denoc_ros.dynamics.robot import Robot, load_robot
from denoc_ros.types import Array

REACH_INVERSE = (0.9, 0.6, 0.6)
REACH_FORWARD = (0.9, 0.6, 0.6)
REACH_SSRMS_INVERSE = 4.0  # times inverse dynamics
REACH_SSRMS_FORWARD = 5.0  # times forward dynamics
REACH_SSRMS_PEER = 1.0
REACH_SLOPE = 2.05  # the result has n^2 entries
LINKS = (8, 16, 32, 64)
FEWER_LINKS = (4, 8)
MODES = (1, 1, 0)
TOLERANCE = 1e-9
STEP = 1e-3  # of the central differences of fourth order that check a flexible robot
DIFFERENCE = 1e-7  # their truncation and rounding


def derivative_lines(file: Path, effort: Effort, quick: bool) -> Iterator[BenchLine]:
    """Yield all lines of the derivatives; file is the SSRMS."""
    yield from _rigid_lines(effort)
    yield from _ssrms_lines(file, effort)
    yield from _growth_lines(effort, quick)


def _rigid_lines(effort: Effort) -> Iterator[BenchLine]:
    for n, inverse, forward in zip(SIZES, REACH_INVERSE, REACH_FORWARD, strict=True):
        text = rigid_chain(n)
        robot, peer, states = load_robot(text), Pinocchio(text), random_states(load_robot(text))
        pushed, limit = driven(robot, states), max(TOLERANCE, conditioned(robot, states))
        for verb, theirs, given, reach, least in (
            ('inverse', peer.inverse_derivatives(states), states, inverse, TOLERANCE),
            ('forward', peer.forward_derivatives(pushed), pushed, forward, limit),
        ):
            ours = getattr(robot, f'{verb}_dynamics_derivatives')
            yield from pair('derivatives', ours, given, theirs, reach, effort, least, full)


def full(matrices: Array) -> Array:
    """Return three matrices of Pinocchio's, the lower half of the last filled in."""
    upper = np.triu(matrices[2])
    return np.stack([matrices[0], matrices[1], upper + np.triu(upper, 1).T])


def _ssrms_lines(file: Path, effort: Effort) -> Iterator[BenchLine]:
    """Yield the SSRMS: beside the functions themselves, and Pinocchio's rigid chain."""
    robot, text = load_robot(file), rigid_chain(load_robot(file).n)
    states = random_states(robot)
    pushed = driven(robot, states)
    chain, peer = load_robot(text), Pinocchio(text)
    rigid = random_states(chain)
    thrown = driven(chain, rigid)
    inverse = Subject(robot.inverse_dynamics_derivatives, states)
    forward = Subject(robot.forward_dynamics_derivatives, pushed)
    theirs = (
        peer.inverse_dynamics(rigid),
        peer.inverse_derivatives(rigid),
        peer.forward_dynamics(thrown),
        peer.forward_derivatives(thrown),
    )
    plain = (Subject(robot.inverse_dynamics, states), Subject(robot.forward_dynamics, pushed))
    checks = (check_inverse(robot, states), check_forward(robot, pushed, states))
    size = f'SSRMS, {robot.n} coordinates'
    names = [f'{verb}_dynamics_derivatives, {size}' for verb in ('inverse', 'forward')]
    if not all(each.good for each in checks):
        for name, each in zip(names, checks, strict=True):
            yield BenchLine('derivatives', name, each.against, each)
        return
    times = compare((inverse, forward, *plain, *theirs), effort)
    own, peers = times[:2], times[4:]
    for name, each, ours, function, limit, both in (
        (names[0], checks[0], own[0], times[2], REACH_SSRMS_INVERSE, peers[:2]),
        (names[1], checks[1], own[1], times[3], REACH_SSRMS_FORWARD, peers[2:]),
    ):
        asked = ratio(both[1], both[0]).value
        yield BenchLine(
            'derivatives', name, 'the function itself', each, value=ratio(ours, function),
            reach=Reach(limit), ours=ours, peer=function,
            note=f'Pinocchio, rigid n = {robot.n}: {asked:.2f} times its function',
        )  # fmt: skip
    yield BenchLine(
        'derivatives', names[1], f'pin.computeABADerivatives, rigid n = {robot.n}', checks[1],
        value=ratio(own[1], peers[3]), reach=Reach(REACH_SSRMS_PEER), ours=own[1],
        peer=peers[3],
    )  # fmt: skip


def _growth_lines(effort: Effort, quick: bool) -> Iterator[BenchLine]:
    """Yield the slopes of all-flexible chains: time by number of links."""
    sizes = FEWER_LINKS if quick else LINKS

    def made(n: int) -> Made:
        robot = load_robot(flexible_chain(n, *MODES))
        states = random_states(robot, count=2)
        pushed = driven(robot, states)
        checks = [check_forward(robot, pushed, states)]
        if n == sizes[0]:
            checks.append(check_inverse(robot, states))
        inverse = Subject(robot.inverse_dynamics_derivatives, states)
        return (inverse, Subject(robot.forward_dynamics_derivatives, pushed)), checks

    yield from slope_lines('derivatives', sizes, made, REACH_SLOPE, effort)


def check_inverse(robot: Robot, states: Sequence[State]) -> BenchCheck:
    """Compare with central differences of inverse dynamics along random directions."""
    rng = np.random.default_rng(1)
    errors = []
    for q, qd, qdd in states:
        by_q, by_rate, inertia = robot.inverse_dynamics_derivatives(q, qd, qdd)
        d, e, f = rng.uniform(-1.0, 1.0, (3, robot.n)) * np.abs((q, qd, qdd))
        values = [
            robot.inverse_dynamics(q + s * d, qd + s * e, qdd + s * f)
            for s in (STEP, -STEP, 2.0 * STEP, -2.0 * STEP)
        ]
        found = (8.0 * (values[0] - values[1]) - (values[2] - values[3])) / (12.0 * STEP)
        exact = by_q @ d + by_rate @ e + inertia @ f
        errors.append(float(np.abs(found - exact).max() / np.abs(exact).max()))
    return BenchCheck('differences of inverse_dynamics', max(errors), DIFFERENCE)


def check_forward(robot: Robot, pushed: Sequence[State], states: Sequence[State]) -> BenchCheck:
    """Compare I times the derivatives with those of inverse dynamics."""
    errors = []
    for (q, qd, tau), (_, _, qdd) in zip(pushed, states, strict=True):
        of_torque = robot.inverse_dynamics_derivatives(q, qd, qdd)
        of_motion = robot.forward_dynamics_derivatives(q, qd, tau)
        wanted = (-of_torque[0], -of_torque[1], np.eye(robot.n))
        for value, expected in zip(of_motion, wanted, strict=True):
            left = of_torque[2] @ value - expected
            size = np.abs(of_torque[2]) @ np.abs(value)
            errors.append(float(np.abs(left).max() / size.max()))
    return BenchCheck('I times the derivatives', max(errors), TOLERANCE)
