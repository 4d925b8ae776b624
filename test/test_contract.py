"""What users lean on stays: public names, parameters and commands are added, never taken away.

`python test/test_contract.py` adds what is new to the list in test/data.
"""

from __future__ import annotations

import argparse
import inspect
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import denoc_ros as dn
from denoc_ros.cli.main import build_parser
from denoc_ros.cli.session.session_config import NODES
from denoc_ros.cli.verbs import verbs
from denoc_ros.parts import parameter_table

# What is written, packed or listed is the whole package.
pytestmark = pytest.mark.parts('all')

ROOT = Path(__file__).resolve().parents[1]
LIST = ROOT / 'test' / 'data' / 'contract.json'
# a row of a table: names, then the type of a message or service
TOPIC = re.compile(r'^\| (`[^|]+) \| \w+_(?:msgs|srvs)/')


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


def topics() -> dict[str, list[str]]:
    """Return the topics and services of each node, as docs/nodes.md has them."""
    found: dict[str, list[str]] = {}
    node = ''
    for line in (ROOT / 'docs' / 'nodes.md').read_text(encoding='utf-8').splitlines():
        if line.startswith('## '):
            node = line[3:]
        elif node in NODES and (row := TOPIC.match(line)):
            found |= {f'{node}: {name}': [] for name in re.findall(r'`([^`]+)`', row[1])}
    return found


NOW = {
    'python': python_names,
    'parameters': parameters,
    'commands': commands,
    'topics': topics,
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


@pytest.mark.parametrize('kind', NOW)
def test_nothing_public_is_taken_away(kind: str) -> None:
    listed = json.loads(LIST.read_text(encoding='utf-8'))[kind]
    assert lost(kind, listed, NOW[kind]()) == []


@pytest.mark.parametrize('kind', NOW)
def test_list_is_complete(kind: str) -> None:
    listed = json.loads(LIST.read_text(encoding='utf-8'))[kind]
    missing = NOW[kind]().keys() - listed.keys()
    assert not missing, f'python test/test_contract.py adds {sorted(missing)}'


def test_what_is_taken_away_is_seen() -> None:
    before: dict[str, list[Any]] = {'f': ['q', 'qd'], 'g': []}
    assert lost('python', before, {'f': ['q', 'qd', 'out']}) == ['g']
    assert lost('python', before, {'f': ['qd', 'q'], 'g': []})
    assert lost('parameters', {'a': ['double', 1.0]}, {'a': ['double', 2.0]})
    assert lost('commands', {'denoc check': ['--at']}, {'denoc check': ['--json']})


if __name__ == '__main__':
    kept = json.loads(LIST.read_text(encoding='utf-8')) if LIST.exists() else {}
    grown = {kind: {**find(), **kept.get(kind, {})} for kind, find in NOW.items()}
    rows = [
        f'"{kind}": {{\n'
        + ',\n'.join(f'{json.dumps(name)}: {json.dumps(names[name])}' for name in sorted(names))
        for kind, names in sorted(grown.items())
    ]
    LIST.write_text('{\n' + '\n},\n'.join(rows) + '\n}\n}\n', encoding='utf-8')
