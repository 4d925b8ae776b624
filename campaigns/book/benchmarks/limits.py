"""Operations per call, compared with the book's tables and with an ideal machine.

The ideal machine does one scalar multiplication with its addition at the rate measured on this
one, never waits for a result or for memory, and has no calls: max(M, A) fused operations.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from book.benchmarks.operations import (
    CountingKernels,
    Machine,
    Operations,
    measure_machine,
)
from book.benchmarks.peers import flexible_chain, rigid_chain
from book.benchmarks.results import BenchCheck, relative_error
from book.benchmarks.rigid import State, random_states
from book.benchmarks.timing import Effort, Subject, compare

from denoc_ros.dynamics.robot import Robot, load_robot

NOTHING = '<robot name="nothing"><link name="base"/></robot>'
TOLERANCE = 1e-8  # of a solution, the source in Python against its compiled self

FORWARD = 'forward dynamics'
INERTIA_AND_BIAS = 'inertia matrix and bias'
INVERSE = 'inverse dynamics'

Printed = Mapping[str, Mapping[str, tuple[int, int]]]  # verb: {author: (M, A)}

# Printed in the book's tables 1.1 (rigid, here at n = 6), 1.2 and 3.1: multiplications, additions.
# Its m = 2 are the modes of bending per link, one per plane.
RIGID_SIX: Printed = {
    FORWARD: {
        'Mohan-Saha': (173 * 6 - 128, 150 * 6 - 133),
        'Shah': (135 * 6 - 116, 131 * 6 - 123),
        'Featherstone': (199 * 6 - 198, 174 * 6 - 173),
        'Brandl': (250 * 6 - 222, 220 * 6 - 198),
    },
    INVERSE: {'Saha': (120 * 6 - 44, 97 * 6 - 55), 'Walker-Orin': (137 * 6 - 22, 101 * 6 - 11)},
}
SIX_LINKS: Printed = {
    FORWARD: {'Mohan-Saha': (9038, 7311), 'Cyril': (10812, 8538)},
    INERTIA_AND_BIAS: {
        'Mohan-Saha': (3635, 2893),
        'Cyril': (7612, 6526),
        'King': (9799, 8064),
        'Book': (34593, 33653),
    },
}
EIGHT_LINKS: Printed = {
    FORWARD: {'Mohan-Saha': (9874, 7699), 'Jain-Rodriguez, 9 links': (11889, 9387)}
}


@dataclass(frozen=True)
class Case:
    """A robot whose operations are counted, and the book's count for one like it."""

    name: str
    text: str
    printed: Printed


CASES = (
    Case('rigid n = 6', rigid_chain(6), RIGID_SIX),
    Case('6 links, a mode per plane, one of torsion', flexible_chain(6, 1, 1, 1), SIX_LINKS),
    Case('6 links, two per plane, one of torsion', flexible_chain(6, 2, 2, 1), SIX_LINKS),
    Case('8 links, a mode per plane', flexible_chain(8, 1, 1, 0), EIGHT_LINKS),
    Case('8 links, two per plane', flexible_chain(8, 2, 2, 0), EIGHT_LINKS),
)


@dataclass(frozen=True)
class Budget:
    """Where the time of a call goes [s]; None where nothing was timed."""

    call: float  # the public call
    # the call less that on a robot that has no coordinates: without what Python costs
    kernel: float
    ideal: float  # all multiplications and additions on the ideal machine
    functions: float  # divisions, roots, sines and cosines at the rates measured

    @property
    def parts(self) -> dict[str, float]:
        """The call's time, divided up; the rest is loads, stores and waiting for results."""
        rest = self.kernel - self.ideal - self.functions
        return {
            'ideal': self.ideal,
            'functions': self.functions,
            'rest of the kernel': rest,
            'call': self.call - self.kernel,
        }


@dataclass(frozen=True)
class Account:
    """Operations of one verb on one robot, beside the book and the ideal machine."""

    case: str
    coordinates: int
    verb: str
    check: BenchCheck
    operations: Operations
    shares: Mapping[str, int]  # multiplications and additions by kernel, most first
    printed: Mapping[str, tuple[int, int]]
    budget: Budget | None

    def record(self) -> dict[str, Any]:
        """Return plain lists and numbers, ready for JSON."""
        budget = self.budget and {**asdict(self.budget), 'parts': self.budget.parts}
        return {
            'case': self.case,
            'coordinates': self.coordinates,
            'verb': self.verb,
            'check': {**asdict(self.check), 'good': self.check.good},
            'operations': asdict(self.operations),
            'shares': dict(self.shares),
            'printed': {name: list(counts) for name, counts in self.printed.items()},
            'budget_s': budget,
        }


def accounts(effort: Effort, quick: bool) -> Iterator[Account]:
    """Yield the operations of every case; timed as well unless quick."""
    machine = None if quick else measure_machine()
    for case in CASES:
        robot = load_robot(case.text)
        state = random_states(robot, count=1)[0]
        for count in count_verbs(robot, state):
            verb, operations = count.verb, count.operations
            budget = None if machine is None else _budget(robot, verb, operations, machine, effort)
            printed = case.printed.get(verb, {})
            yield Account(
                case.name, robot.n, verb, count.check, operations, count.shares, printed, budget
            )


@dataclass(frozen=True)
class Count:
    """Operations of one call of a verb, and whether its result was right."""

    verb: str
    operations: Operations
    shares: dict[str, int]
    check: BenchCheck


def count_verbs(robot: Robot, state: State) -> Iterator[Count]:
    """Yield operations of inverse dynamics, forward dynamics, inertia matrix and bias.

    Parameters
    ----------
    state : (q, qd, qdd), each (n,)
    """
    q, qd, qdd = state
    n = robot.n
    kernels = CountingKernels(robot)
    tau = robot.inverse_dynamics(q, qd, qdd)
    inverse, torque = kernels.count('dynamics.inverse', 'find_torque', q, qd, qdd, np.zeros(n))
    yield _count(INVERSE, inverse, kernels.shares, _check(torque, tau))
    forward, found = kernels.count(
        'dynamics.articulated', 'find_acceleration', q, qd, tau, np.zeros(n)
    )
    check = _check(found, robot.forward_dynamics(q, qd, tau))
    yield _count(FORWARD, forward, kernels.shares, check)
    inertia, matrix = kernels.count('dynamics.composite', 'find_inertia', q, np.zeros((n, n)))
    shares = Counter(kernels.shares)
    bias, _ = kernels.count('dynamics.inverse', 'find_torque', q, qd, np.zeros(n), np.zeros(n))
    check = _check(matrix, robot.inertia_matrix(q))
    yield _count(INERTIA_AND_BIAS, inertia + bias, shares + Counter(kernels.shares), check)


def _count(
    verb: str, operations: Operations, shares: Mapping[str, int], check: BenchCheck
) -> Count:
    most_first = dict(Counter(shares).most_common())
    return Count(verb, operations, most_first, check)


def _check(counted: Any, compiled: Any) -> BenchCheck:
    return BenchCheck('the compiled kernel', relative_error(counted, compiled), TOLERANCE)


def _budget(
    robot: Robot, verb: str, operations: Operations, machine: Machine, effort: Effort
) -> Budget:
    states = random_states(robot, count=16)
    if verb == FORWARD:
        states = [(q, qd, robot.inverse_dynamics(q, qd, qdd)) for q, qd, qdd in states]
    nothing = load_robot(NOTHING)
    call = Subject(_verb(robot, verb), states)
    empty = Subject(_verb(nothing, verb), [(np.zeros(0),) * 3])
    full, bare = compare((call, empty), effort)
    return Budget(
        full.median,
        full.median - bare.median,
        machine.fused * max(operations.multiplications, operations.additions),
        machine.division * operations.divisions
        + machine.root * operations.roots
        + machine.trigonometric * operations.trigonometric,
    )


def _verb(robot: Robot, verb: str) -> Callable[..., Any]:
    if verb == INVERSE:
        return robot.inverse_dynamics
    if verb == FORWARD:
        return robot.forward_dynamics

    def inertia_and_bias(q: Any, qd: Any, _: Any) -> None:
        robot.inertia_matrix(q)
        robot.bias_forces(q, qd)

    return inertia_and_bias
