"""The index and the reference of the nodes: their tables are those of the code.

`python test/test_readme.py` writes the tables.
"""

from __future__ import annotations

import argparse
import re
from pathlib import Path

import pytest

from denoc_ros.cli.main import build_parser
from denoc_ros.cli.session.session_config import NODES
from denoc_ros.cli.verbs import verbs
from denoc_ros.parts import parameter_table

# What is written, packed or listed is the whole package.
pytestmark = pytest.mark.parts('all')

ROOT = Path(__file__).resolve().parent.parent
README = ROOT / 'README.md'
INDEX, NODES_PAGE = ROOT / 'docs' / 'index.md', ROOT / 'docs' / 'nodes.md'
SECTION = re.compile(r'(<!-- begin (\w+) (\w+) -->\n)(.*?)(<!-- end -->)', re.DOTALL)


def rendered(kind: str, name: str) -> str:
    """Return what a generated section must hold."""
    if kind == 'parameters':
        table = parameter_table(name)
        return f'\n{table.markdown()}\n'
    lines = ['', '| command | does |', '|---|---|']
    for verb in verbs():
        parser = build_parser([verb])
        (action,) = (a for a in parser._actions if isinstance(a, argparse._SubParsersAction))
        lines.append(f'| `denoc {verb}` | {action._choices_actions[0].help} |')
    return '\n'.join(lines) + '\n\n'


def sections(page: Path) -> dict[tuple[str, str], str]:
    """Return the generated sections that a page has."""
    found = SECTION.findall(page.read_text(encoding='utf-8'))
    return {(kind, name): text for _, kind, name, text, _ in found}


@pytest.mark.ros
@pytest.mark.parametrize('node', NODES)
def test_parameter_table_is_the_node_s(node: str) -> None:
    assert sections(NODES_PAGE)['parameters', node] == rendered('parameters', node)


def test_command_table_is_the_command_line_s() -> None:
    assert sections(INDEX)['commands', 'denoc'] == rendered('commands', 'denoc')


def test_every_make_target_shown_exists(repository: Path) -> None:
    targets = set(
        re.findall(r'^(\w+):', (repository / 'Makefile').read_text(encoding='utf-8'), re.MULTILINE)
    )
    shown = set(re.findall(r'`make (\w+)', README.read_text(encoding='utf-8')))
    assert {'demo', 'test', 'check'} <= shown <= targets


if __name__ == '__main__':
    for page in (INDEX, NODES_PAGE):
        text = page.read_text(encoding='utf-8')
        page.write_text(SECTION.sub(lambda m: m[1] + rendered(m[2], m[3]) + m[5], text))
