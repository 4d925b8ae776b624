"""CONTRIBUTING, SECURITY, CITATION and the issue templates agree with the repository.

`python test/test_contributing.py` writes the index of the modules that tests share.
"""

from __future__ import annotations

import ast
import re
import xml.etree.ElementTree as ElementTree
from importlib.metadata import metadata
from pathlib import Path

import pytest
import yaml

PAGES = ('CONTRIBUTING.md', 'SECURITY.md', 'CODE_OF_CONDUCT.md')
TEMPLATES = ('fault.yml', 'robot.yml')
SUPPORT = Path(__file__).resolve().parent / 'support'


@pytest.mark.parametrize('name', PAGES)
def test_links_lead_to_files_and_headings(repository: Path, name: str) -> None:
    links = re.findall(r'\]\((?!https?:)([^)#]+)(?:#([^)]*))?\)', (repository / name).read_text())
    assert links or name != 'CONTRIBUTING.md'
    for file, anchor in links:
        path = repository / file
        assert path.exists(), file
        if anchor:
            headings = re.findall(r'^#+ (.*)$', path.read_text(), re.MULTILINE)
            known = [re.sub(r'[^\w\- ]', '', each.lower()).replace(' ', '-') for each in headings]
            assert anchor in known, anchor


def test_commands_exist(repository: Path) -> None:
    text = (repository / 'CONTRIBUTING.md').read_text()
    makefile = (repository / 'Makefile').read_text()
    targets = set(re.findall(r'`?make (\w+)', text))
    assert {'venv', 'lint', 'check', 'test'} <= targets
    for target in targets:
        assert re.search(rf'^{target}:', makefile, re.MULTILINE), target
    # a path may name a file of the reader's own
    paths = re.findall(r'`((?:test|docs|config)/[^`]+)`', text)
    assert paths
    for path in paths:
        assert (repository / path.partition('NAME')[0]).exists(), path


def support_index() -> str:
    """Return the index of the modules that tests share: a line per module, its docstring's."""
    lines = [
        '# Modules that tests share',
        '',
        'A test imports these modules by their file names. `python test/test_contributing.py`',
        'writes this page from the first lines of their docstrings.',
    ]
    for folder in sorted({path.parent for path in SUPPORT.rglob('*.py')}):
        lines += ['', f'## {folder.name}', '', '| module | has |', '|---|---|']
        for path in sorted(folder.glob('*.py')):
            text = ast.get_docstring(ast.parse(path.read_text(encoding='utf-8'))) or ''
            lines.append(f'| `{path.stem}` | {text.partition(chr(10))[0]} |')
    return '\n'.join(lines) + '\n'


def test_index_of_shared_test_modules_is_complete() -> None:
    assert (SUPPORT / 'README.md').read_text(encoding='utf-8') == support_index()
    assert '|  |' not in support_index()


def test_citation_has_the_version_and_licence_of_the_package(repository: Path) -> None:
    citation = yaml.safe_load((repository / 'CITATION.cff').read_text())
    package = ElementTree.parse(repository / 'package.xml').getroot()
    assert citation['version'] == package.findtext('version')
    assert citation['license'] == package.findtext('license')
    assert {'cff-version', 'message', 'title', 'authors'} <= set(citation)


@pytest.mark.parametrize('name', TEMPLATES)
def test_templates_ask_for_a_check_and_a_recording(repository: Path, name: str) -> None:
    text = (repository / '.github/ISSUE_TEMPLATE' / name).read_text()
    form = yaml.safe_load(text)
    assert {'name', 'description', 'body'} <= set(form)
    fields = {part['id']: part['attributes']['label'] for part in form['body']}
    assert len(fields) == len(form['body'])
    assert 'denoc check --json' in fields['check']
    assert 'recording' in fields['recording'].lower()


def test_workflows_run_the_versions_of_the_package(repository: Path) -> None:
    folder = repository / '.github' / 'workflows'
    job = yaml.safe_load((folder / 'test.yml').read_text())['jobs']['test']
    assert job['steps'][-1] == {'run': '.ci/run'}
    package = metadata('denoc_ros').get_all('Classifier') or []
    versions = [name.rpartition(' ')[2] for name in package if re.search(r':: 3\.\d+$', name)]
    assert job['strategy']['matrix']['python'] == versions
    steps = yaml.safe_load((folder / 'build.yml').read_text())['jobs']['build']['steps']
    assert 'make docs' in [step.get('run') for step in steps]


if __name__ == '__main__':
    (SUPPORT / 'README.md').write_text(support_index(), encoding='utf-8')
