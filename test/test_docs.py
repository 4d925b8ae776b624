"""README and docs: every snippet runs, in the order of its page, in a folder of the page's own."""

from __future__ import annotations

import io
import re
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

import pytest
from pages import Snippet, shows, snippets
from snippet_kinds import check_xml, check_yaml, run_command

ROOT = Path(__file__).resolve().parent.parent
PAGES = [ROOT / 'README.md', *sorted((ROOT / 'docs').glob('*.md'))]
LANGUAGES = {'python', 'sh', 'yaml', 'xml', 'text', ''}
OF_ROS = re.compile(r'^(denoc up |ros2 |denoc-)|ros__parameters|^nodes:', re.MULTILINE)


def page_parameters() -> list[Any]:
    """Return the pages; those whose snippets need nodes are marked so."""
    return [
        pytest.param(
            page,
            id=page.stem,
            marks=[pytest.mark.ros]
            if any(OF_ROS.search(snippet.text) for snippet in snippets(page))
            else [],
        )
        for page in PAGES
    ]


@pytest.mark.parametrize('page', page_parameters())
def test_every_snippet_runs(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ('config', 'docs', 'test', 'launch'):
        (tmp_path / name).symlink_to(ROOT / name)
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {'__name__': 'page'}
    output = ''
    for snippet in snippets(page):
        if 'skip' not in snippet.directive:
            try:
                output = run(snippet, names, tmp_path, output)
            except Exception as error:
                raise AssertionError(f'{snippet.where} ({snippet.language}): {error}') from error


def run(snippet: Snippet, names: dict[str, Any], folder: Path, before: str) -> str:
    """Run one snippet; return what it printed, or what the one before did."""
    assert snippet.language in LANGUAGES, snippet.language
    if snippet.language == 'xml':
        check_xml(snippet, folder)
    elif snippet.language == 'yaml':
        check_yaml(snippet, folder)
    elif 'output' in snippet.directive:
        missing = [row for row in snippet.text.splitlines() if row and not shows(before, row)]
        assert not missing, f'not printed: {missing}; but\n{before}'
    elif snippet.language in ('python', 'sh'):
        with redirect_stdout(io.StringIO()) as printed:
            execute(snippet, names)
        return printed.getvalue()
    return before


def execute(snippet: Snippet, names: dict[str, Any]) -> None:
    """Run code in the page's names, or commands one after another."""
    if snippet.language == 'python':
        exec(compile(snippet.text, snippet.where, 'exec'), names)
        return
    for words in snippet.commands():
        run_command(words, snippet)


@pytest.mark.parametrize('page', PAGES, ids=[page.stem for page in PAGES])
def test_every_link_leads_somewhere(page: Path) -> None:
    text = page.read_text(encoding='utf-8')
    targets = re.findall(r'\]\((?!https?:|#)([^)#]+)', text) + re.findall(r'src="([^"]+)"', text)
    assert [target for target in targets if not (page.parent / target).exists()] == []


def test_every_page_is_linked_from_the_readme() -> None:
    linked = re.findall(r'\]\(docs/([^)#]+\.md)', PAGES[0].read_text(encoding='utf-8'))
    assert {page.name for page in PAGES[1:]} <= set(linked)


@pytest.mark.parametrize(
    ('line', 'shown'),
    [
        ('zeta 0.0120', True),  # as printed, or the last digit off
        ('zeta   0.0119', True),
        ('zeta 0.0130', False),
        ('omega 0.0120', False),
        ('2 modes, 1.2e-3 m', True),
        ('3 modes, 1.2e-3 m', False),
    ],
)
def test_an_output_that_is_not_printed_is_found_out(line: str, shown: bool) -> None:
    assert shows('zeta 0.0120\n  2 modes, 1.195e-03 m', line) == shown
