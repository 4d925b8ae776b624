"""Derivatives of the dynamics: rigid chains and the SSRMS beside Pinocchio, and their growth."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from denoc_ros.dynamics.robot import Robot, load_robot
from denoc_ros.studies.benchmarks.growth import sloped
from denoc_ros.studies.benchmarks.peers import Pinocchio, flexible_chain, rigid_chain
from denoc_ros.studies.benchmarks.results import AT_MOST, BenchCheck, BenchLine, Reach
from denoc_ros.studies.benchmarks.rigid import (
    SIZES,
    State,
    beside,
    check,
    conditioned,
    random_states,
    results,
)
from denoc_ros.studies.benchmarks.timing import Effort, Subject, compare, ratio
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
        driven = [(q, qd, robot.inverse_dynamics(q, qd, qdd)) for q, qd, qdd in states]
        for verb, theirs, arguments, reach, limit in (
            (
                robot.inverse_dynamics_derivatives,
                peer.inverse_derivatives(states),
                states,
                inverse,
                TOLERANCE,
            ),
            (
                robot.forward_dynamics_derivatives,
                peer.forward_derivatives(driven),
                driven,
                forward,
                max(TOLERANCE, conditioned(robot, states)),
            ),
        ):
            ours = Subject(verb, arguments)
            bare = Subject(verb, [(*state, None, None, False) for state in arguments])
            against = f'pin.{theirs.call.__name__}'
            whole = [full(each) for each in results(theirs)]
            yield from beside(
                'derivatives', f'{verb.__name__}, rigid n = {n}', against, (ours, bare, theirs),
                check(results(ours), whole, against, limit), reach, effort,
            )  # fmt: skip


def full(matrices: Array) -> Array:
    """Return three matrices of Pinocchio's, the lower half of the last filled in."""
    upper = np.triu(matrices[2])
    return np.stack([matrices[0], matrices[1], upper + np.triu(upper, 1).T])


def _ssrms_lines(file: Path, effort: Effort) -> Iterator[BenchLine]:
    """Yield the SSRMS: beside the functions themselves, and Pinocchio's rigid chain."""
    robot, text = load_robot(file), rigid_chain(load_robot(file).n)
    states = random_states(robot)
    driven = [(q, qd, robot.inverse_dynamics(q, qd, qdd)) for q, qd, qdd in states]
    chain, peer = load_robot(text), Pinocchio(text)
    rigid = random_states(chain)
    pushed = [(q, qd, chain.inverse_dynamics(q, qd, qdd)) for q, qd, qdd in rigid]
    inverse = Subject(robot.inverse_dynamics_derivatives, states)
    forward = Subject(robot.forward_dynamics_derivatives, driven)
    theirs = (
        peer.inverse_dynamics(rigid),
        peer.inverse_derivatives(rigid),
        peer.forward_dynamics(pushed),
        peer.forward_derivatives(pushed),
    )
    plain = (Subject(robot.inverse_dynamics, states), Subject(robot.forward_dynamics, driven))
    checks = (check_inverse(robot, states), check_forward(robot, driven, states))
    size = f'SSRMS, {robot.n} coordinates'
    names = [f'{verb}_dynamics_derivatives, {size}' for verb in ('inverse', 'forward')]
    if not all(each.good for each in checks):
        for name, each in zip(names, checks, strict=True):
            yield BenchLine('derivatives', name, each.against, each)
        return
    times = compare((inverse, forward, *plain, *theirs), effort)
    own, peers = times[:2], times[4:]
    for name, each, ours, function, limit, pair in (
        (names[0], checks[0], own[0], times[2], REACH_SSRMS_INVERSE, peers[:2]),
        (names[1], checks[1], own[1], times[3], REACH_SSRMS_FORWARD, peers[2:]),
    ):
        asked = ratio(pair[1], pair[0]).value
        yield BenchLine(
            'derivatives', name, 'the function itself', each, value=ratio(ours, function),
            reach=Reach(AT_MOST, limit), ours=ours, peer=function,
            note=f'Pinocchio, rigid n = {robot.n}: {asked:.2f} times its function',
        )  # fmt: skip
    yield BenchLine(
        'derivatives', names[1], f'pin.computeABADerivatives, rigid n = {robot.n}', checks[1],
        value=ratio(own[1], peers[3]), reach=Reach(AT_MOST, REACH_SSRMS_PEER), ours=own[1],
        peer=peers[3],
    )  # fmt: skip


def _growth_lines(effort: Effort, quick: bool) -> Iterator[BenchLine]:
    """Yield the slopes of all-flexible chains: time by number of links."""
    sizes = FEWER_LINKS if quick else LINKS
    inverse, forward, checks = [], [], []
    for n in sizes:
        robot = load_robot(flexible_chain(n, *MODES))
        states = random_states(robot, count=2)
        driven = [(q, qd, robot.inverse_dynamics(q, qd, qdd)) for q, qd, qdd in states]
        inverse.append(Subject(robot.inverse_dynamics_derivatives, states))
        forward.append(Subject(robot.forward_dynamics_derivatives, driven))
        checks.append(check_forward(robot, driven, states))
        if n == sizes[0]:
            checks.append(check_inverse(robot, states))
    checked = max(checks, key=lambda each: each.error / each.tolerance)
    for name, subjects in (('inverse', inverse), ('forward', forward)):
        what = f'{name}_dynamics_derivatives, all-flexible chains n = {sizes[0]} … {sizes[-1]}'
        line = BenchLine('derivatives', what, 'own slope, log-log', checked, 'slope')
        yield sloped(line, sizes, subjects, REACH_SLOPE, effort)


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


def check_forward(robot: Robot, driven: Sequence[State], states: Sequence[State]) -> BenchCheck:
    """Compare I times the derivatives with those of inverse dynamics."""
    errors = []
    for (q, qd, tau), (_, _, qdd) in zip(driven, states, strict=True):
        of_torque = robot.inverse_dynamics_derivatives(q, qd, qdd)
        of_motion = robot.forward_dynamics_derivatives(q, qd, tau)
        wanted = (-of_torque[0], -of_torque[1], np.eye(robot.n))
        for value, expected in zip(of_motion, wanted, strict=True):
            left = of_torque[2] @ value - expected
            size = np.abs(of_torque[2]) @ np.abs(value)
            errors.append(float(np.abs(left).max() / size.max()))
    return BenchCheck('I times the derivatives', max(errors), TOLERANCE)
