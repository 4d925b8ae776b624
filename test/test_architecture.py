"""docs/architecture.md names rooms and files as they are; all paths in texts and code exist."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

# The page names the whole package.
pytestmark = pytest.mark.parts('all')

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / 'denoc_ros'
PAGE = (ROOT / 'docs' / 'architecture.md').read_text(encoding='utf-8')
PROJECT = (ROOT / 'pyproject.toml').read_text(encoding='utf-8')
FILES = sorted(set(re.findall(r'`((?:denoc_ros|test)/[\w/]+\.py)`', PAGE)))
# `file`, `Name`: what is to be found in it
INSIDE = re.findall(r'`((?:denoc_ros|test)/[\w/]+\.py)`, `([\w.]+)`', PAGE)
# A capital letter stands for a name of the reader's own, a star or a brace for several files.
PATH = re.compile(r'(?<![\w/.-])(?:denoc_ros|test|campaigns)(?:/[\w.-]+)+\b(?![*{/])')
MODULE = re.compile(r'(?<![\w/.-])denoc_ros(?:\.[A-Za-z]\w*)+')
# Modules that tests make up.
INVENTED = (
    'denoc_ros.dynamics.three',
    'denoc_ros.dynamics.four',
    'denoc_ros.identification.level',
)


def layers() -> list[list[str]]:
    """Return the rooms of each row of the contract, from the top."""
    (rows,) = re.findall(r'^layers = \[(.*?)^\]', PROJECT, re.MULTILINE | re.DOTALL)
    return [re.findall(r'denoc_ros\.(\w+)', row) for row in rows.strip().splitlines()]


def rooms() -> list[list[str]]:
    """Return the rooms of each row of the contract that are folders."""
    return [[name for name in row if (PACKAGE / name).is_dir()] for row in layers()]


def table() -> list[str]:
    """Return the rooms in the table of the page."""
    return re.findall(r'^\| `(\w+)` \|', PAGE, re.MULTILINE)


def test_rooms_of_the_page_are_those_of_the_contract_in_its_order() -> None:
    assert len(FILES) > 30
    places = {name: place for place, row in enumerate(rooms()) for name in row}
    assert sorted(table()) == sorted(places)
    assert [places[name] for name in table()] == sorted(places[name] for name in table())


def test_every_room_is_in_the_contract() -> None:
    found = {path.parent.name for path in PACKAGE.glob('*/__init__.py')}
    assert found == {name for row in rooms() for name in row}


@pytest.mark.parametrize('name', FILES)
def test_named_files_are_there(name: str) -> None:
    placeholder = name.replace('NAME', 'plant').replace('VERB', 'check')
    assert (ROOT / placeholder).is_file()


@pytest.mark.parametrize(('file', 'what'), INSIDE, ids=[f'{f}-{w}' for f, w in INSIDE])
def test_what_is_named_is_in_its_file(file: str, what: str) -> None:
    text = (ROOT / file).read_text(encoding='utf-8')
    for part in what.split('.'):
        assert re.search(rf'(class|def) {part}\b', text), f'{file} has no {part}'


def texts() -> Iterator[tuple[Path, str]]:
    """Yield the documents and sources of the checkout."""
    folders = ('denoc_ros', 'test', 'campaigns', 'docs', 'launch', 'config')
    files = [path for name in folders for path in (ROOT / name).rglob('*')]
    for path in sorted([*ROOT.glob('*.md'), *files]):
        if path.suffix in {'.md', '.py'} and 'fuzz' not in path.parts:
            yield path, path.read_text(encoding='utf-8')


def is_module(name: str) -> bool:
    """Say whether a dotted name is a module of the package, or a name in one."""
    here, parts = PACKAGE, name.split('.')[1:]
    while parts and (here / parts[0]).is_dir():
        here /= parts.pop(0)
    if not parts:
        return True
    module = here / f'{parts[0]}.py'
    inside, words = (module, parts[1:]) if module.is_file() else (here / '__init__.py', parts[:1])
    text = inside.read_text(encoding='utf-8')
    return all(re.search(rf'\b{word}\b', text) for word in words)


def test_paths_in_documents_and_sources_exist() -> None:
    missing = [
        f'{file.relative_to(ROOT)}: {path}'
        for file, text in texts()
        for path in PATH.findall(text)
        if not re.search('[A-Z]', path.rpartition('/')[2].partition('.')[0])
        if not (ROOT / path).exists()
    ]
    assert missing == []


def test_modules_in_documents_and_sources_exist() -> None:
    missing = [
        f'{file.relative_to(ROOT)}: {name}'
        for file, text in texts()
        for name in MODULE.findall(text)
        if not name.startswith(INVENTED) and not name.endswith('.log') and not is_module(name)
    ]
    assert missing == []
