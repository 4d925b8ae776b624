"""Kernels of a session are compiled by processes beside each other."""

from __future__ import annotations

import ast
import pkgutil
from collections.abc import Iterator, Sequence
from importlib import import_module
from importlib.util import find_spec
from itertools import product
from pathlib import Path
from typing import Any

import pytest

import denoc_ros
from denoc_ros.cli import warmup_verb as warmup
from denoc_ros.errors import DenocError


def named(kernels: Sequence[Any]) -> list[str]:
    return [each.py_func.__name__ for each in kernels]


def test_heavy_kernels_are_at_both_ends() -> None:
    found = named(warmup.kernels(loops=False, plans=True))
    assert {found[0], found[-1]} <= set(warmup.HEAVY)
    assert len(found) == len(set(found))


def test_a_session_needs_what_is_compiled_ahead_of_all() -> None:
    every = warmup.all_kernels()
    for what in product((False, True), repeat=4):
        assert set(warmup.kernels(*what)) <= set(warmup.all_kernels(loops=what[0]))
    assert set(warmup.all_kernels(loops=False)) < set(every)


def test_python_calls_no_compiled_function_that_warmup_leaves_out() -> None:
    """What any module of the package can call is among what `denoc warmup` compiles."""
    every = set(warmup.all_kernels())
    called, seen = set(), 0
    for module in pkgutil.walk_packages(denoc_ros.__path__, 'denoc_ros.'):
        if '.kernels' in module.name:
            continue
        file = Path(denoc_ros.__path__[0], *module.name.split('.')[1:])
        source = file.with_suffix('.py') if not file.is_dir() else file / '__init__.py'
        for name, function in from_kernels(ast.parse(source.read_text(encoding='utf-8'))):
            kernel = getattr(import_module(name), function, None)
            if hasattr(kernel, 'py_func'):
                called.add(kernel)
                seen += 1
    assert seen > 30
    assert named(sorted(called - every, key=repr)) == []


def from_kernels(tree: ast.AST) -> Iterator[tuple[str, str]]:
    """Yield (module, name) of what a file takes from kernels, as names or by `module.name`."""
    modules: dict[str, str] = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and '.kernels' in (node.module or ''):
            for alias in node.names:
                yield str(node.module), alias.name
                modules[alias.asname or alias.name] = f'{node.module}.{alias.name}'
    for node in ast.walk(tree):
        if not isinstance(node, ast.Attribute) or not isinstance(node.value, ast.Name):
            continue
        module = modules.get(node.value.id, '')
        if module and find_spec(module) is not None:
            yield module, node.attr


@pytest.mark.long
def test_nothing_is_expected_once_all_are_compiled() -> None:
    wanted = warmup.kernels(loops=False, plans=False)
    warmup.compile_all(wanted)
    assert warmup.estimate(wanted) == 0.0
    assert warmup.measured_speed(wanted) == 1.0


def test_a_slow_machine_is_told_a_longer_time(monkeypatch: pytest.MonkeyPatch) -> None:
    wanted = warmup.kernels(loops=False, plans=False)
    monkeypatch.setattr(warmup, 'missing', lambda wanted: list(wanted))
    fast, slow = (warmup.estimate(wanted, speed) for speed in (1.0, 0.5))
    own = warmup.LOADING
    assert slow - own == pytest.approx(2.0 * (fast - own))
    assert warmup.counted(wanted[:1]) == '1 kernel'
    assert warmup.counted(wanted[:2]) == '2 kernels'


def test_a_process_that_fails_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    wanted = warmup.kernels(loops=False, plans=False)
    monkeypatch.setattr('sys.executable', 'false')
    with pytest.raises(DenocError, match='compilation must succeed, got exit status 1'):
        warmup.compile_all(wanted)
    # and what watches may end the wait
    monkeypatch.undo()
    with pytest.raises(InterruptedError):
        warmup.compile_all(wanted, watch=interrupt)


def interrupt() -> None:
    raise InterruptedError
