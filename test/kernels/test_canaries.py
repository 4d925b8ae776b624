"""No verb writes beside its outputs or its workspace, or reads beside its inputs."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import pytest
from canaries import CANARY, ROOM, Canaries, guarded_workspace
from looped_robots import random_closed
from mechanisms import DOWN, START, mechanism
from spring_oracle import elastic_robot
from strategies import random_state, seeded_robot

from denoc_ros.dynamics.robot import Robot, load_robot
from denoc_ros.dynamics.stepper import Stepper
from denoc_ros.types import Array

pytestmark = pytest.mark.usefixtures('two_threads')
ROWS = 70


@pytest.fixture
def canaries(monkeypatch: pytest.MonkeyPatch) -> Iterator[Canaries]:
    """Guards around the workspace of every robot that is made from here on."""
    made = Canaries()
    monkeypatch.setattr('denoc_ros.dynamics.robot_model.Workspace', guarded_workspace(made))
    yield made
    made.check()


def call_verbs(robot: Robot, canaries: Canaries, q: Array, qd: Array, qdd: Array) -> None:
    """Call every verb with `out=` on guarded arrays, states or rows of them."""
    n, rows = robot.n, q.shape[:-1]
    given = {
        name: canaries.of(name, value) for name, value in (('q', q), ('qd', qd), ('qdd', qdd))
    }
    q, qd, qdd = given.values()
    frame = list(robot.tree.frames)[-1]
    verbs: dict[str, tuple[tuple[int, ...], Callable[[Array], Array]]] = {
        'inverse_dynamics': ((n,), lambda out: robot.inverse_dynamics(q, qd, qdd, out=out)),
        'forward_dynamics': ((n,), lambda out: robot.forward_dynamics(q, qd, qdd, out=out)),
        'bias_forces': ((n,), lambda out: robot.bias_forces(q, qd, out=out)),
        'inertia_matrix': ((n, n), lambda out: robot.inertia_matrix(q, out=out)),
        'energy': ((2,), lambda out: robot.energy(q, qd, out=out)),
        'frame_pose': ((4, 4), lambda out: robot.frame_pose(frame, q, out=out)),
        'frame_jacobian': ((6, n), lambda out: robot.frame_jacobian(frame, q, out=out)),
    }
    for name, (shape, verb) in verbs.items():
        out = canaries.array(name, (*rows, *shape))
        assert verb(out) is out
        assert np.isfinite(out).all(), name
        canaries.check()
    robot.hybrid_dynamics(q, qd, qdd[..., robot.joint_indices])
    canaries.check()


def advance(robot: Robot, canaries: Canaries, q: Array, qd: Array) -> None:
    """Advance a guarded state, free and driven."""
    stepper = Stepper(robot, 1e-4)
    stepper._steps = canaries.of('steps', stepper._steps)
    q, qd = canaries.of('stepped q', q), canaries.of('stepped qd', qd)
    force = canaries.array('force', robot.n, 0.0)
    for _ in range(3):
        stepper.free(q, qd, force)
    if not robot.constraint_names:
        stepper.driven(q, qd, canaries.array('driven', len(robot.joint_names), 0.0))
    assert np.isfinite([q, qd]).all()
    canaries.check()


@pytest.mark.parametrize('seed', range(8))
def test_random_trees_write_where_they_should(canaries: Canaries, seed: int) -> None:
    robot = load_robot(seeded_robot(seed, 2 + seed))
    state = random_state(robot.coordinate_names, seed)
    call_verbs(robot, canaries, state.q, state.qd, state.qdd)
    advance(robot, canaries, state.q, state.qd)


@pytest.mark.parametrize('seed', [2, 15])
def test_elastic_joints_write_where_they_should(canaries: Canaries, seed: int) -> None:
    robot = load_robot(elastic_robot(seed))
    state = random_state(robot.coordinate_names, seed)
    call_verbs(robot, canaries, state.q, state.qd, state.qdd)
    factors = np.linspace(0.5, 1.0, ROWS)[:, None]
    call_verbs(robot, canaries, factors * state.q, factors * state.qd, factors * state.qdd)
    advance(robot, canaries, state.q, state.qd)


@pytest.mark.parametrize('seed', [3, 5])
def test_rows_write_where_they_should(canaries: Canaries, seed: int) -> None:
    robot = load_robot(seeded_robot(seed, 6))
    state = random_state(robot.coordinate_names, seed)
    factors = np.linspace(0.5, 1.0, ROWS)[:, None]
    call_verbs(robot, canaries, factors * state.q, factors * state.qd, factors * state.qdd)


@pytest.mark.parametrize('seed', [2, 5, 7])
def test_derivatives_write_where_they_should(canaries: Canaries, seed: int) -> None:
    robot = load_robot(seeded_robot(seed, 2 + seed))
    n, state = robot.n, random_state(robot.coordinate_names, seed)
    rows = np.ones((ROWS, 1))
    for scale, shape in ((1.0, (n, n)), (rows, (ROWS, n, n))):
        q, qd, qdd = (
            canaries.of(name, scale * value)
            for name, value in (('q', state.q), ('qd', state.qd), ('qdd', state.qdd))
        )
        for verb in (robot.inverse_dynamics_derivatives, robot.forward_dynamics_derivatives):
            out = [canaries.array(f'{verb.__name__} {k}', shape) for k in range(3)]
            for result, given in zip(verb(q, qd, qdd, out=out), out, strict=True):
                assert result is given
                assert np.isfinite(result).all()
            canaries.check()
        robot.hybrid_dynamics_derivatives(q, qd, qdd[..., robot.joint_indices])
        canaries.check()


def call_constrained(robot: Robot, canaries: Canaries, q: Array, qd: Array) -> None:
    """Call the verbs of loops on guarded arrays."""
    q, qd = canaries.of('q', q), canaries.of('qd', qd)
    for result in (
        robot.closure(q),
        robot.closure_jacobian(q),
        robot.closure_bias(q, qd),
        *robot.constrained_forward_dynamics(q, qd, canaries.array('tau', q.shape, 0.0)),
    ):
        assert np.isfinite(result).all()
    canaries.check()


def guarded_out(canaries: Canaries, robot: Robot, a: int, rows: tuple[int, ...]) -> list[Array]:
    """Guarded arrays for the derivatives of constrained hybrid dynamics, a joints actuated."""
    n, r = robot.n, len(robot.constraint_names)
    shapes = [(length, count) for length in (a, n, r) for count in (n, n, a, n)]
    return [canaries.array(f'result {k}', (*rows, *x)) for k, x in enumerate(shapes)]


def call_constrained_derivatives(robot: Robot, canaries: Canaries, q: Array, qd: Array) -> None:
    """Call the derivatives of the verbs of loops on guarded arrays, with wrenches."""
    q, qd = canaries.of('q', q), canaries.of('qd', qd)
    tau = canaries.array('tau', q.shape, 0.1)
    wrenches = {robot.tree.bodies[-1].name: np.ones(6)}
    names = robot.joint_names[:1]
    given = np.ascontiguousarray(tau[..., :1])
    out = guarded_out(canaries, robot, 1, q.shape[:-1])
    hybrid = robot.constrained_hybrid_dynamics_derivatives
    forward = robot.constrained_forward_dynamics_derivatives
    inverse = robot.constrained_inverse_dynamics_derivatives
    qdd = robot.constrained_forward_dynamics(q, qd, canaries.array('none', q.shape, 0.0))[0]
    for found in (
        hybrid(q, qd, given, names, tau, out=out, wrenches=wrenches),
        forward(q, qd, tau, out=[*out[4:6], out[7], *out[8:10], out[11]], wrenches=wrenches),
        inverse(q, qd, qdd, names, out=[*out[:2], out[3], *out[8:10], out[11]]),
    ):
        assert all(np.isfinite(result).all() for result in found)
        canaries.check()


@pytest.mark.parametrize('kind', ['revolute', 'prismatic', 'universal', 'spherical', 'fixed'])
def test_derivatives_of_loops_write_where_they_should(canaries: Canaries, kind: str) -> None:
    closed = random_closed(4, kind, mimic=kind == 'spherical')
    q, qd = closed.q, closed.qd
    call_constrained_derivatives(closed.robot, canaries, q, qd)
    q, qd = np.tile(q, (ROWS, 1)), np.tile(qd, (ROWS, 1))
    call_constrained_derivatives(closed.robot, canaries, q, qd)


@pytest.mark.parametrize('kind', ['revolute', 'prismatic', 'universal', 'spherical', 'fixed'])
def test_random_loops_write_where_they_should(canaries: Canaries, kind: str) -> None:
    closed = random_closed(4, kind, mimic=kind == 'spherical')
    robot, q, qd = closed.robot, closed.q, closed.qd
    call_verbs(robot, canaries, q, qd, qd)
    call_constrained(robot, canaries, q, qd)
    advance(robot, canaries, q, qd)
    call_constrained(robot, canaries, np.tile(q, (ROWS, 1)), np.tile(qd, (ROWS, 1)))


@pytest.mark.parametrize(
    ('table', 'kind'), [('four_bar', 'RFF'), ('five_bar', 'FFFF'), ('planar_3dof', '3RF')]
)
def test_mechanisms_write_where_they_should(canaries: Canaries, table: str, kind: str) -> None:
    robot = load_robot(mechanism(table, kind), gravity=DOWN)
    guess = np.zeros(robot.n)
    guess[robot.joint_indices] = START[table]
    q = robot.assemble(guess)
    call_verbs(robot, canaries, q, np.zeros(robot.n), np.zeros(robot.n))
    call_constrained(robot, canaries, q, np.zeros(robot.n))
    advance(robot, canaries, q, np.zeros(robot.n))


@pytest.mark.parametrize('offset', [-1, 5])
def test_a_write_beside_an_array_is_found_out(offset: int) -> None:
    canaries = Canaries()
    inner = canaries.array('out', 5)
    canaries.check()
    buffer = inner.base
    assert buffer is not None
    buffer[ROOM + offset] = 0.0
    with pytest.raises(AssertionError, match='out: 1 elements'):
        canaries.check()
    assert np.isnan(CANARY)
