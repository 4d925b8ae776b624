"""Operations counted from the kernels: exact where a hand can count, linear in the links."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from book.benchmarks.limits import FORWARD, INVERSE, count_verbs
from book.benchmarks.operations import Counted, CountingKernels, Operations
from book.benchmarks.peers import flexible_chain, rigid_chain
from book.benchmarks.rigid import random_states
from numpy.typing import ArrayLike

from denoc_ros.dynamics.robot import load_robot

VECTOR = np.array([1.0, 2.0, 3.0])


@pytest.fixture(scope='module')
def kernels() -> CountingKernels:
    return CountingKernels(load_robot(rigid_chain(1)))


@pytest.mark.parametrize(
    ('name', 'expected', 'multiplications', 'additions'),
    [
        ('dot', 10.0, 3, 2),
        ('cross', [-4.0, 8.0, -4.0], 6, 3),
        ('add', [4.0, 4.0, 4.0], 0, 3),
    ],
)
def test_counts_of_vector_products_are_those_of_a_hand(
    kernels: CountingKernels, name: str, expected: ArrayLike, multiplications: int, additions: int
) -> None:
    u, v = kernels.counted(VECTOR), kernels.counted(VECTOR[::-1].copy())
    before = Operations(*kernels.tally.parts)
    result = kernels.function('algebra.vector', name)(tuple(u), tuple(v))
    np.testing.assert_array_equal(np.array(result, dtype=np.float64), expected)
    parts = np.subtract(kernels.tally.parts, before.parts)
    assert parts.tolist() == [multiplications, additions, 0, 0, 0]


def test_functions_are_counted_by_kind() -> None:
    tally = Operations()
    x: Any = Counted(0.25, tally)
    y = np.sqrt(x) / 2.0 + np.sin(x) * np.cos(x) - np.tanh(-x) ** 2
    assert tally.parts == (2, 2, 1, 1, 3)
    expected = 0.25 + np.sin(0.25) * np.cos(0.25) - np.tanh(0.25) ** 2
    assert float(y) == pytest.approx(expected)


@pytest.mark.parametrize(
    'chain', [rigid_chain, lambda n: flexible_chain(n, 2, 2, 1)], ids=['rigid', 'flexible']
)
def test_dynamics_grow_linearly_with_the_links(chain: Callable[[int], str]) -> None:
    counts: dict[str, list[tuple[int, ...]]] = {INVERSE: [], FORWARD: []}
    for n in (6, 12, 18):
        robot = load_robot(chain(n))
        for count in count_verbs(robot, random_states(robot, count=1)[0]):
            assert count.check.good
            assert sum(count.shares.values()) == sum(count.operations.parts[:2])
            if count.verb in counts:
                counts[count.verb].append(count.operations.parts)
    for parts in counts.values():
        first, second = np.diff(parts, axis=0)
        np.testing.assert_array_equal(first, second)
        assert first[0] > 0
