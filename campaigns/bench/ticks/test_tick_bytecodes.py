"""The counter of a tick's bytecodes."""

from __future__ import annotations

import pytest
from bench.ticks.tick_bytecodes import Tracer

pytestmark = pytest.mark.ros  # the bench imports nodes


def called(_number: int) -> None: ...


def work(count: int) -> None:
    for number in range(count):
        called(number)


def counted(count: int) -> tuple[int, int]:
    tracer = Tracer()
    tracer.run(lambda: work(count))
    assert sum(tracer.by_function.values()) == tracer.bytecodes
    return tracer.bytecodes, tracer.calls


def test_each_bytecode_and_call_counts_once() -> None:
    (none, calls), (one, _), (five, more) = counted(0), counted(1), counted(5)
    assert calls == 2  # the lambda, and `work`
    assert more == calls + 5
    assert five - none == 5 * (one - none) > 0
    assert counted(5) == (five, more)
