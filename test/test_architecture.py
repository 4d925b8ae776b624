"""docs/architecture.md names layers and files as they are."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PAGE = (ROOT / 'docs' / 'architecture.md').read_text(encoding='utf-8')
PROJECT = (ROOT / 'pyproject.toml').read_text(encoding='utf-8')
FILES = sorted(set(re.findall(r'`((?:denoc_ros|test)/[\w/]+\.py)`', PAGE)))
# `file`, `Name`: what is to be found in it
INSIDE = re.findall(r'`((?:denoc_ros|test)/[\w/]+\.py)`, `([\w.]+)`', PAGE)


def layers() -> list[list[str]]:
    """Return the packages of each row of the contract, from the top."""
    (rows,) = re.findall(r'^layers = \[(.*?)^\]', PROJECT, re.MULTILINE | re.DOTALL)
    return [re.findall(r'denoc_ros\.(\w+)', row) for row in rows.strip().splitlines()]


def is_package(name: str) -> bool:
    return (ROOT / 'denoc_ros' / name).is_dir()


def test_the_page_has_files_and_packages_of_the_contract() -> None:
    assert len(FILES) > 30
    listed = re.findall(r'^\| `(\w+)` \|', PAGE, re.MULTILINE)
    assert sorted(listed) == sorted(name for row in layers() for name in row if is_package(name))


def test_every_package_is_in_the_contract() -> None:
    packages = {path.parent.name for path in (ROOT / 'denoc_ros').glob('*/__init__.py')}
    assert packages == {name for row in layers() for name in row if is_package(name)}


def test_packages_stand_in_the_order_of_their_layers() -> None:
    places = {name: place for place, row in enumerate(layers()) for name in row}
    table = re.findall(r'^\| `(\w+)` \|', PAGE, re.MULTILINE)
    assert [places[name] for name in table] == sorted(places[name] for name in table)


@pytest.mark.parametrize('name', FILES)
def test_named_files_are_there(name: str) -> None:
    placeholder = name.replace('NAME', 'plant').replace('VERB', 'check')
    assert (ROOT / placeholder).is_file()


@pytest.mark.parametrize(('file', 'what'), INSIDE, ids=[f'{f}-{w}' for f, w in INSIDE])
def test_what_is_named_is_in_its_file(file: str, what: str) -> None:
    text = (ROOT / file).read_text(encoding='utf-8')
    for part in what.split('.'):
        assert re.search(rf'(class|def) {part}\b', text), f'{file} has no {part}'
