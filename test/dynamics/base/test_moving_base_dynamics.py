"""A base that moves equals the same robot on six prescribed joints, whatever the verb."""

from __future__ import annotations

from contextlib import suppress
from typing import Any

import numpy as np
import pytest
from base_robots import SIX, base_motion, pair, states

import denoc_ros as dn
from denoc_ros.dynamics.robot import Robot
from denoc_ros.errors import StateError
from denoc_ros.types import Array

GRAVITY = np.array([1.0, -9.0, 3.0])
# rounding of two recursions, one six joints longer, over up to 26 coordinates
RELATIVE = 1e-10
ROBOTS = ('canadarm', 'ssrms', 'stanford_flexible', 'puma', 'spinning_beam')


def close(value: Any, expected: Any) -> None:
    scale = max(float(np.abs(expected).max(initial=0.0)), 1e-6)
    np.testing.assert_allclose(value, expected, rtol=0, atol=RELATIVE * scale)


class Case:
    """One robot, the same on six joints, and a state of both."""

    def __init__(self, name: str, seed: int = 3) -> None:
        self.robot, self.carried, self.root = pair(name, GRAVITY)
        rng = np.random.default_rng(seed)
        self.q6, self.qd6, self.qdd6 = states(self.carried, rng)
        self.q, self.qd, self.qdd = self.q6[6:], self.qd6[6:], self.qdd6[6:]
        self.base = base_motion(self.carried, self.root, (self.q6, self.qd6, self.qdd6))
        self.tau = rng.normal(size=self.robot.n)
        self.wrench = rng.normal(size=6)

    def in_world(self) -> dict[str, Array]:
        """The wrench, given in base axes, in world axes."""
        turn = self.base[2][:3, :3]
        return {'tool': np.concatenate([turn @ self.wrench[:3], turn @ self.wrench[3:]])}


@pytest.fixture(scope='module', params=ROBOTS)
def case(request: pytest.FixtureRequest) -> Case:
    return Case(request.param)


def test_inverse_dynamics(case: Case) -> None:
    tau = case.carried.inverse_dynamics(case.q6, case.qd6, case.qdd6)[6:]
    close(case.robot.inverse_dynamics(case.q, case.qd, case.qdd, base=case.base), tau)
    bias = case.carried.inverse_dynamics(case.q6, case.qd6, np.append(case.qdd6[:6], 0 * case.qdd))
    close(case.robot.bias_forces(case.q, case.qd, base=case.base), bias[6:])


def test_forward_dynamics(case: Case) -> None:
    force = np.append(np.zeros(6), case.tau)
    _, qdd = case.carried.hybrid_dynamics(
        case.q6, case.qd6, case.qdd6[:6], joints=SIX, tau=force, wrenches=case.in_world()
    )
    made = case.robot.forward_dynamics(
        case.q, case.qd, case.tau, {'tool': case.wrench}, base=case.base
    )
    close(made, qdd)


def test_hybrid_dynamics(case: Case) -> None:
    given = case.qdd6[case.carried.joint_indices]
    tau, free = case.carried.hybrid_dynamics(case.q6, case.qd6, given)
    made = case.robot.hybrid_dynamics(case.q, case.qd, given[6:], base=case.base)
    close(made[0], tau[6:])
    close(made[1], free)


def test_derivatives(case: Case) -> None:
    made = case.robot.inverse_dynamics_derivatives(case.q, case.qd, case.qdd, base=case.base)
    wanted = case.carried.inverse_dynamics_derivatives(case.q6, case.qd6, case.qdd6)
    for one, other in zip(made, wanted, strict=True):
        close(one, other[6:, 6:])
    forward = case.robot.forward_dynamics_derivatives(case.q, case.qd, case.tau, base=case.base)
    joints = case.carried.hybrid_dynamics_derivatives(
        case.q6, case.qd6, case.qdd6[:6], joints=SIX, tau=np.append(np.zeros(6), case.tau)
    )
    close(forward[0], joints.dqdd_dq[:, 6:])
    close(forward[1], joints.dqdd_dqd[:, 6:])
    close(forward[2], joints.inverse_inertia)
    given = case.qdd6[case.carried.joint_indices]
    hybrid = case.robot.hybrid_dynamics_derivatives(case.q, case.qd, given[6:], base=case.base)
    both = case.carried.hybrid_dynamics_derivatives(case.q6, case.qd6, given)
    close(hybrid.dtau_dq, both.dtau_dq[6:, 6:])
    close(hybrid.dqdd_dqd, both.dqdd_dqd[:, 6:])


def test_motion_energy_and_momentum(case: Case) -> None:
    turn, arm = case.base[2][:3, :3], case.base[2][:3, 3]
    twist, acceleration = case.carried.frame_motion('tool', case.q6, case.qd6, case.qdd6)
    made = case.robot.frame_motion('tool', case.q, case.qd, case.qdd, base=case.base)
    for one, other in zip(made, (twist, acceleration), strict=True):
        close(np.concatenate([turn @ one[:3], turn @ one[3:]]), other)
    close(
        case.robot.energy(case.q, case.qd, base=case.base), case.carried.energy(case.q6, case.qd6)
    )
    linear, angular = np.split(case.robot.momentum(case.q, case.qd, base=case.base), 2)
    wanted = case.carried.momentum(case.q6, case.qd6)
    close(turn @ linear, wanted[:3])
    close(turn @ angular + np.cross(arm, turn @ linear), wanted[3:])
    close(turn @ case.robot.centre_of_mass(case.q) + arm, case.carried.centre_of_mass(case.q6))


def test_regressor(case: Case) -> None:
    paths = ['payload.tool.mass']
    made = case.robot.torque_regressor(case.q, case.qd, case.qdd, paths, base=case.base)
    wanted = case.carried.torque_regressor(case.q6, case.qd6, case.qdd6, paths)
    close(made, wanted[6:])


def test_loops() -> None:
    robot, carried, root = pair('four_bar_rff', GRAVITY)
    rng = np.random.default_rng(2)
    q, qd, qdd = states(robot, rng, 0.01)
    q = robot.assemble(q)
    qd = robot.assemble_rates(q, qd)
    six = rng.uniform(-1, 1, (3, 6))
    q6, qd6 = np.append(six[0], q), np.append(six[1], qd)
    tau = rng.normal(size=robot.n)
    names = carried.joint_names[6:]
    # what the joints that move the base need: then the base moves as given
    crank = [names[0]]
    given = np.append(six[2], qdd[robot.indices(crank)])
    torque, found, multipliers = carried.constrained_hybrid_dynamics(
        q6, qd6, given, actuated=[*SIX, *crank], tau=np.append(np.zeros(6), tau)
    )
    base = base_motion(carried, root, (q6, qd6, found))
    made = robot.constrained_hybrid_dynamics(q, qd, given[6:], crank, tau, base=base)
    close(made[0], torque[6:])
    close(made[1], found[6:])
    close(made[2], multipliers)
    force = tau.copy()
    force[robot.indices(crank)] = made[0]
    again = robot.constrained_forward_dynamics(q, qd, force, base=base)
    close(again[0], found[6:])
    close(again[1], multipliers)


def test_inverse_dynamics_of_loops() -> None:
    """Without amplitudes any motion that keeps the loops closed is possible."""
    robot, carried, root = pair('four_bar_rrr', GRAVITY)
    rng = np.random.default_rng(2)
    q, qd, _ = states(robot, rng)
    q = robot.assemble(q)
    qd = robot.assemble_rates(q, qd)
    crank = [robot.joint_names[0]]
    six = rng.uniform(-1, 1, (3, 6))
    q6, qd6 = np.append(six[0], q), np.append(six[1], qd)
    torque, qdd6, multipliers = carried.constrained_hybrid_dynamics(
        q6, qd6, np.append(six[2], 0.7), actuated=[*SIX, *crank]
    )
    base = base_motion(carried, root, (q6, qd6, qdd6))
    made = robot.constrained_inverse_dynamics(q, qd, qdd6[6:], crank, base=base)
    close(made[0], torque[6:])
    close(made[1], multipliers)


def test_spinning_base_stretches_and_loads_the_static_beam() -> None:
    """A clamped beam that spins with its base bends as one that gravity of that strength bends."""
    robot = dn.load_robot(pair('clamped_beam', GRAVITY)[0].tree.source, gravity=(0, 0, 0))
    joints = np.zeros(len(robot.joint_indices))
    pushed = robot.static_deflection(joints, base=(np.zeros(6), [0, -2.0, 0, 0, 0, 0]))
    heavy = dn.load_robot(robot.tree.source, gravity=(0, 2.0, 0)).static_deflection(joints)
    close(pushed, heavy)
    spun = robot.static_deflection(joints, base=([0, 0, 0, 0, 0, 10.0], [0, -2.0, 0, 0, 0, 0]))
    assert np.abs(spun).max() < 0.999 * np.abs(pushed).max()  # centrifugal stiffening


@pytest.fixture(scope='module')
def arm() -> Case:
    return Case('ssrms')


def test_one_motion_or_one_for_each_row(arm: Case) -> None:
    rng = np.random.default_rng(5)
    q, qd, qdd = 0.1 * rng.normal(size=(3, 4, arm.robot.n))
    twists, accelerations = rng.normal(size=(2, 4, 6))
    pose = arm.base[2]
    each = [
        arm.robot.inverse_dynamics(q[k], qd[k], qdd[k], base=(twists[k], accelerations[k], pose))
        for k in range(4)
    ]
    rows = arm.robot.inverse_dynamics(q, qd, qdd, base=(twists, accelerations, pose))
    close(rows, np.array(each))
    out = np.empty((4, arm.robot.n))
    one = arm.robot.inverse_dynamics(q, qd, qdd, out=out, base=(twists[1], accelerations[1], pose))
    assert one is out
    close(out[1], each[1])
    by_state = arm.robot.inverse_dynamics(q[2], qd[2], qdd[2], base=(twists, accelerations, pose))
    assert by_state.shape == (4, arm.robot.n)
    derivatives = arm.robot.inverse_dynamics_derivatives(q, qd, qdd, base=(twists, accelerations))
    assert [part.shape for part in derivatives] == [(4, arm.robot.n, arm.robot.n)] * 3
    hybrid = arm.robot.hybrid_dynamics_derivatives(
        q, qd, qdd[:, arm.robot.joint_indices], base=(twists, accelerations)
    )
    assert hybrid.inverse_inertia.shape[0] == 4


@pytest.mark.usefixtures('two_threads')
def test_many_rows_in_threads(arm: Case) -> None:
    """Workspaces of other threads move alike."""
    q, qd, qdd = (np.tile(x, (500, 1)) for x in (arm.q, arm.qd, arm.qdd))
    tau = arm.robot.inverse_dynamics(arm.q, arm.qd, arm.qdd, base=arm.base)
    close(arm.robot.inverse_dynamics(q, qd, qdd, base=arm.base), np.tile(tau, (500, 1)))


def test_the_base_rests_again_after_a_verb(arm: Case) -> None:
    still = arm.robot.inverse_dynamics(arm.q, arm.qd, arm.qdd)
    arm.robot.inverse_dynamics(arm.q, arm.qd, arm.qdd, base=arm.base)
    close(arm.robot.inverse_dynamics(arm.q, arm.qd, arm.qdd), still)
    with pytest.raises(StateError):
        arm.robot.inverse_dynamics(arm.q, arm.qd, np.full(arm.robot.n, np.nan), base=arm.base)
    assert arm.robot.base_motion is None
    close(arm.robot.inverse_dynamics(arm.q, arm.qd, arm.qdd), still)


def test_move_base_stays_until_it_is_changed(arm: Case) -> None:
    robot: Robot = arm.robot.copy()
    moved = robot.inverse_dynamics(arm.q, arm.qd, arm.qdd, base=arm.base)
    robot.move_base(arm.base)
    close(robot.inverse_dynamics(arm.q, arm.qd, arm.qdd), moved)
    other = (np.ones(6), np.zeros(6))
    assert np.abs(robot.inverse_dynamics(arm.q, arm.qd, arm.qdd, base=other) - moved).max() > 0.1
    close(robot.inverse_dynamics(arm.q, arm.qd, arm.qdd), moved)
    robot.move_base(None)
    close(
        robot.inverse_dynamics(arm.q, arm.qd, arm.qdd),
        arm.robot.inverse_dynamics(arm.q, arm.qd, arm.qdd),
    )


REFUSED = [
    ((np.zeros(6),), 'base must be .*got 1 parts'),
    (5.0, 'base must be .*got 5.0'),
    ((np.zeros(5), np.zeros(6)), r'base twist must have shape \(6,\)'),
    ((np.zeros(6), [0, 0, 0, 0, 0, np.nan]), 'base acceleration must be finite'),
    ((np.zeros(6), np.zeros(6), np.eye(3)), r'base pose must have shape \(4, 4\)'),
    ((np.zeros(6), np.zeros(6), np.diag([2.0, 1, 1, 1])), 'base pose must have a proper rotation'),
    ((np.zeros(6), np.zeros(6), np.diag([-1.0, 1, 1, 1])), 'base pose must have a proper rot'),
    ((np.zeros((2, 6)), np.zeros((3, 6))), 'same number of rows'),
    ((np.zeros((3, 6)), np.zeros((3, 6))), r'base and states must have the same number of rows'),
]


@pytest.mark.parametrize(('base', 'message'), REFUSED)
def test_a_wrong_base_is_refused(arm: Case, base: Any, message: str) -> None:
    rows = np.zeros((2, arm.robot.n))
    with pytest.raises(StateError, match=message):
        arm.robot.inverse_dynamics(rows, rows, rows, base=base)


def test_live_motion_is_one_motion(arm: Case) -> None:
    with pytest.raises(StateError, match='base must be one motion, got 2 rows'):
        arm.robot.move_base((np.zeros((2, 6)), np.zeros(6)))


def test_a_base_moves_for_every_verb_of_a_block(case: Case) -> None:
    robot, state = case.robot, (case.q, case.qd, case.qdd)
    rested = robot.inverse_dynamics(*state)
    other = (np.ones(6), np.zeros(6))
    with robot.on_base(case.base) as moved:
        assert moved is robot
        verbs: list[tuple[Any, tuple[Array, ...]]] = [
            (robot.inverse_dynamics, state),
            (robot.forward_dynamics, (case.q, case.qd, case.tau)),
            (robot.energy, state[:2]),
        ]
        for verb, given in verbs:
            np.testing.assert_array_equal(verb(*given), verb(*given, base=case.base))
        with suppress(ZeroDivisionError), robot.on_base(other):
            inner = robot.inverse_dynamics(*state)
            raise ZeroDivisionError
        np.testing.assert_array_equal(
            robot.inverse_dynamics(*state), robot.inverse_dynamics(*state, base=case.base)
        )
    np.testing.assert_array_equal(inner, robot.inverse_dynamics(*state, base=other))
    np.testing.assert_array_equal(robot.inverse_dynamics(*state), rested)
    rows = (np.zeros((2, 6)), np.zeros((2, 6)))
    with (
        pytest.raises(StateError, match='base must be one motion, got 2 rows'),
        robot.on_base(rows),
    ):
        pass
    assert robot.base_motion is None
