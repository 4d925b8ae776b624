"""What users lean on stays: public names, parameters and commands are added, never taken away.

`python test/test_contract.py` adds what is new to the list in test/data.
"""

from __future__ import annotations

import argparse
import inspect
import json
import re
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

import denoc_ros as dn
from denoc_ros.cli.main import build_parser
from denoc_ros.cli.session.session_config import NODES
from denoc_ros.cli.verbs import verbs
from denoc_ros.parts import parameter_table

ROOT = Path(__file__).resolve().parents[1]
LIST = ROOT / 'test' / 'data' / 'contract.json'
IMPORT = re.compile(r'^\s*from (denoc_ros\.[\w.]+) import (.+)$', re.MULTILINE)


def python_names() -> dict[str, list[str]]:
    """Return each public callable or attribute, with the names of its arguments in order."""
    found: dict[str, list[str]] = {}
    for name in dn.__all__:
        value = getattr(dn, name)
        found[name] = [] if is_error(value) else arguments(value)
        if inspect.isclass(value) and not is_error(value):
            for member, what in inspect.getmembers(value):
                if not member.startswith('_'):
                    found[f'{name}.{member}'] = arguments(what)
    return found


def is_error(value: Any) -> bool:
    return inspect.isclass(value) and issubclass(value, Exception)


def arguments(value: Any) -> list[str]:
    return list(inspect.signature(value).parameters) if callable(value) else []


def parameters() -> dict[str, list[Any]]:
    """Return type, default and choices of each node's parameters."""
    found: dict[str, list[Any]] = {}
    for node in NODES:
        table = parameter_table(node)
        for row in table.rows:
            found[f'{node}: {row.name}'] = [row.kind.value, row.default, *row.choices]
    return found


def commands() -> dict[str, list[str]]:
    """Return the options and arguments of each command."""
    found: dict[str, list[str]] = {}
    for verb in verbs():
        for name, parser in parsers(build_parser([verb]), 'denoc'):
            found[name] = sorted(
                option or action.dest
                for action in parser._actions
                for option in action.option_strings or ['']
            )
    return found


def parsers(
    parser: argparse.ArgumentParser, name: str
) -> Iterator[tuple[str, argparse.ArgumentParser]]:
    yield name, parser
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for verb, below in action.choices.items():
                yield from parsers(below, f'{name} {verb}')


def imports() -> dict[str, list[str]]:
    """Return what snippets of the documentation import from below the package."""
    found: dict[str, list[str]] = {}
    for page in (ROOT / 'README.md', *sorted((ROOT / 'docs').glob('*.md'))):
        for module, names in IMPORT.findall(page.read_text(encoding='utf-8')):
            found |= {f'{module}.{name.strip()}': [] for name in names.split(',')}
    return found


NOW = {
    'python': python_names,
    'parameters': parameters,
    'commands': commands,
    'imports': imports,
}


def lost(kind: str, before: dict[str, list[Any]], after: dict[str, list[Any]]) -> list[str]:
    """Return what was there before and is not any more."""
    gone = [name for name in before if name not in after]
    for name in before.keys() & after.keys():
        was, has = before[name], after[name]
        if kind == 'python':  # positional arguments keep their places
            kept = has[: len(was)] == was
        elif kind == 'parameters':
            kept = was[:2] == has[:2] and set(map(str, was[2:])) <= set(map(str, has[2:]))
        else:
            kept = set(was) <= set(has)
        if not kept:
            gone.append(f'{name}: {was} became {has}')
    return sorted(gone)


@pytest.mark.parametrize('kind', ['python', 'parameters', 'commands'])
def test_nothing_public_is_taken_away(kind: str) -> None:
    listed = json.loads(LIST.read_text(encoding='utf-8'))[kind]
    assert lost(kind, listed, NOW[kind]()) == []


@pytest.mark.parametrize('kind', NOW)
def test_list_is_complete(kind: str) -> None:
    listed = json.loads(LIST.read_text(encoding='utf-8'))[kind]
    missing = NOW[kind]().keys() - listed.keys()
    assert not missing, f'python test/test_contract.py adds {sorted(missing)}'


@pytest.mark.parametrize('name', json.loads(LIST.read_text(encoding='utf-8'))['imports'])
def test_what_was_documented_can_still_be_imported(name: str) -> None:
    module, _, attribute = name.rpartition('.')
    assert hasattr(import_module(module), attribute)


def test_what_is_taken_away_is_seen() -> None:
    before: dict[str, list[Any]] = {'f': ['q', 'qd'], 'g': []}
    assert lost('python', before, {'f': ['q', 'qd', 'out']}) == ['g']
    assert lost('python', before, {'f': ['qd', 'q'], 'g': []})
    assert lost('parameters', {'a': ['double', 1.0]}, {'a': ['double', 2.0]})
    assert lost('commands', {'denoc check': ['--at']}, {'denoc check': ['--json']})


if __name__ == '__main__':
    kept = json.loads(LIST.read_text(encoding='utf-8')) if LIST.exists() else {}
    grown = {kind: {**find(), **kept.get(kind, {})} for kind, find in NOW.items()}
    LIST.write_text(json.dumps(grown, indent=1, sort_keys=True) + '\n', encoding='utf-8')
