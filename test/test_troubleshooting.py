"""docs/troubleshooting.md quotes messages that there are."""

from __future__ import annotations

import ast
import re
from functools import cache
from pathlib import Path

import pytest

# What is written, packed or listed is the whole package.
pytestmark = pytest.mark.parts('all')

ROOT = Path(__file__).resolve().parent.parent
ROWS = re.findall(
    r'^\| (`.*?) \| ', (ROOT / 'docs' / 'troubleshooting.md').read_text(), re.MULTILINE
)
QUOTED = [quoted for row in ROWS for quoted in re.findall(r'`([^`]+)`', row)]


@cache
def texts() -> list[str]:
    """Return every text of the package, … where something is put in."""
    found = []
    for file in (ROOT / 'denoc_ros').rglob('*.py'):
        for node in ast.walk(ast.parse(file.read_text(encoding='utf-8'))):
            if isinstance(node, ast.JoinedStr):
                parts = [
                    part.value if isinstance(part, ast.Constant) else '…' for part in node.values
                ]
                found.append(''.join(map(str, parts)))
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                found.append(re.sub(r'\{[^}]*\}', '…', node.value))
    return found


@pytest.mark.parametrize('quoted', QUOTED)
def test_every_message_quoted_is_one_of_the_package(quoted: str) -> None:
    """Its parts between the … stand in one text of the package, in this order."""
    parts = [re.escape(part.strip(' ,:;.')) for part in quoted.split('…')]
    wanted = re.compile('.*'.join(part for part in parts if part), re.DOTALL)
    assert any(wanted.search(text) for text in texts())


def test_a_message_that_there_is_not_is_found_out() -> None:
    assert len(QUOTED) > 50
    with pytest.raises(AssertionError):
        test_every_message_quoted_is_one_of_the_package('torque must be a good one, got …')
