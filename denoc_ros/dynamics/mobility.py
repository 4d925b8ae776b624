"""How loops and mimic joints restrict a robot: rows, rank, degrees of freedom."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from denoc_ros.dynamics.assembling import assemble
from denoc_ros.dynamics.constraints import RANK, closure_rows, jacobian
from denoc_ros.dynamics.robot_model import RobotModel
from denoc_ros.errors import SolverError
from denoc_ros.types import Array

TRIALS = 3  # other configurations that are looked at
SPREAD = 0.3  # rad or m, how far from the first


@dataclass(frozen=True)
class ConstraintMobility:
    """One loop or mimic joint."""

    name: str
    error: float  # of closure with all coordinates zero [m or rad]
    rows: int
    rank: int

    @property
    def redundant(self) -> int:
        """Number of redundant rows."""
        return self.rows - self.rank


@dataclass(frozen=True)
class Mobility:
    """A mechanism in its closed configuration nearest to zero."""

    q: Array  # (n,) the configuration
    failure: str  # why it is not closed, '' if it is
    constraints: tuple[ConstraintMobility, ...]
    rows: int
    rank: int  # of all rows together
    usual_rank: int  # in other configurations: more means that this one is singular
    degrees_of_freedom: int  # of the joints, links taken as rigid, where the rank is the usual one


def rank_of(rows: Array) -> int:
    """Return the rank of constraint rows."""
    values = np.linalg.svd(rows, compute_uv=False)
    return int(np.sum(values > RANK * values.max(initial=1e-300)))


def mobility(robot: RobotModel) -> Mobility:
    """Return the degrees of freedom of a robot under loops and mimic joints."""
    zero = np.zeros(robot.n)
    names = np.array(robot.constraint_names)
    errors = np.abs(closure_rows(robot, zero, zero)[0])
    q, failure = zero, ''
    try:
        q = assemble(robot, zero, ())
    except SolverError as error:
        failure = str(error)
    rows, _ = jacobian(robot, q)
    constraints = []
    for name in dict.fromkeys(robot.constraint_names):
        mine = names == name
        own = rows[mine]
        constraints.append(
            ConstraintMobility(name, float(errors[mine].max()), len(own), rank_of(own))
        )
    usual = rows if failure else _usual_rows(robot, q, rows)
    joints = robot.joint_indices
    return Mobility(
        q,
        failure,
        tuple(constraints),
        len(rows),
        rank_of(rows),
        rank_of(usual),
        len(joints) - rank_of(usual[:, joints]),
    )


def _usual_rows(robot: RobotModel, q: Array, rows: Array) -> Array:
    """Return the Jacobian of greatest rank among that at q and some configurations near it."""
    rng = np.random.default_rng(0)
    for _ in range(TRIALS):
        guess = q.copy()
        guess[robot.joint_indices] += rng.uniform(-SPREAD, SPREAD, len(robot.joint_indices))
        try:
            other, _ = jacobian(robot, assemble(robot, guess, ()))
        except SolverError:
            continue
        if rank_of(other) > rank_of(rows):
            rows = other
    return rows
