"""Kernels of a session are compiled by processes beside each other."""

from __future__ import annotations

import pytest

from denoc_ros.cli import kernels_ahead
from denoc_ros.errors import DenocError


def test_heavy_kernels_are_at_both_ends() -> None:
    found = [each.py_func.__name__ for each in kernels_ahead.kernels(loops=False, plans=True)]
    assert (found[0], found[-1]) == ('forward_dynamics', 'inverse_dynamics_derivatives')
    assert len(found) == len(set(found))


def test_nothing_is_expected_once_all_are_compiled() -> None:
    kernels_ahead.compile_all(loops=False, plans=False)
    assert kernels_ahead.estimate(loops=False, plans=False) == 0.0


def test_a_process_that_fails_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kernels_ahead, 'ORDERS', ('first', 'last'))
    monkeypatch.setattr('sys.executable', 'false')
    with pytest.raises(DenocError, match='compilation must succeed, got exit status 1'):
        kernels_ahead.compile_all(loops=False, plans=False)
    # and what watches may end the wait
    monkeypatch.undo()
    with pytest.raises(InterruptedError):
        kernels_ahead.compile_all(loops=False, plans=False, watch=interrupt)


def interrupt() -> None:
    raise InterruptedError
