"""Optional parts of the package that a test file needs: those it imports, and those it names."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

from denoc_ros.parts import PARTS, parts

ROOT = Path(__file__).resolve().parents[3]
FOLDERS = (*sorted((ROOT / 'test' / 'support').iterdir()), ROOT / 'test', ROOT / 'campaigns')
IMPORTED = re.compile(r'^\s*(?:from|import) ([\w.]+)', re.MULTILINE)
NAMED = re.compile(r'^pytestmark = .*?\bparts\(([^)]*)\)', re.MULTILINE | re.DOTALL)
PUBLIC = re.compile(r'from denoc_ros\.(\w+)\.[\w.]+ import (\w+) as ')
ALL = 'all'


def missing_parts() -> frozenset[str]:
    """Return the parts that are not there, or lack a part that they need."""
    return frozenset(PARTS) - set(parts())


def needed_parts(file: Path) -> frozenset[str]:
    """Return the parts that a file of the tests or campaigns needs, and so do its imports."""
    waiting, seen, found = [file], {file}, set[str]()
    while waiting:
        here = waiting.pop()
        needed, imported = _own_needs(here)
        found |= needed
        waiting += [other for other in imported if other not in seen]
        seen |= set(imported)
    return frozenset(found)


@cache
def _own_needs(file: Path) -> tuple[frozenset[str], tuple[Path, ...]]:
    """Return the parts that a file names, and the files beside it that it imports."""
    text = file.read_text(encoding='utf-8')
    found = {
        name
        for name in PARTS
        if f'denoc_ros.{name}' in text or (ROOT / 'test' / name) in file.parents
    }
    for names in NAMED.findall(text):
        given = set(re.findall(r"'(\w+)'", names))
        found |= set(PARTS) if ALL in given else given
    for name, part in _public_names().items():
        if re.search(rf'\b(?:dn|denoc_ros)\.{name}\b', text):
            found.add(part)
    modules = [module.split('.') for module in IMPORTED.findall(text)]
    files = [folder.joinpath(*m).with_suffix('.py') for m in modules for folder in FOLDERS]
    return frozenset(found), tuple(other for other in files if other.is_file())


@cache
def _public_names() -> dict[str, str]:
    """Return the part of each public Python name that a part has, there or not."""
    text = (ROOT / 'denoc_ros' / '__init__.py').read_text(encoding='utf-8')
    return {name: part for part, name in PUBLIC.findall(text) if part in PARTS}
