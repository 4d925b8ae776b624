"""The site: no warning, no lost link, nothing from the network, every public name."""

from __future__ import annotations

import ast
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import unquote

import nbformat
import pytest
from lxml import html
from sphinx.util.inventory import InventoryFile

import denoc_ros
from denoc_ros.cli.verbs import verbs

# What is written, packed or listed is the whole package.
pytestmark = pytest.mark.parts('all')

ROOT = Path(__file__).resolve().parent.parent
BUILD_TIMEOUT = 1200.0  # s for what takes half a minute on a machine that does nothing else
LONGEST_EXAMPLE = 40  # lines
EXAMPLES = sorted((ROOT / 'docs' / 'examples').glob('*.py'))
NOTEBOOKS = sorted((ROOT / 'docs' / 'notebooks').glob('*.md'))


@pytest.fixture(scope='module')
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the site as `make docs` builds it."""
    folder = tmp_path_factory.mktemp('site')
    (folder / 'source').mkdir()
    command = [sys.executable, '-m', 'sphinx', '--quiet', '--fail-on-warning']
    command += ['-c', str(ROOT / 'docs' / 'site'), '-d', str(folder / 'trees')]
    built = subprocess.run(
        [*command, str(folder / 'source'), str(folder / 'html')],
        capture_output=True,
        text=True,
        stdin=subprocess.DEVNULL,
        timeout=BUILD_TIMEOUT,
        env={**os.environ, 'OPENBLAS_NUM_THREADS': '1'},
    )
    assert built.returncode == 0, built.stderr
    return folder / 'html'


@pytest.fixture(scope='module')
def pages(site: Path) -> dict[Path, html.HtmlElement]:
    """Return the site's pages, but for sources and stand-alone ones."""
    alone = {site / 'source', site / '_static'}
    paths = [path for path in site.rglob('*.html') if path.parent not in alone]
    read = {path: html.parse(str(path)).getroot() for path in paths}
    return {path: page for path, page in read.items() if page.get('data-content_root')}


def anchors(path: Path, pages: dict[Path, html.HtmlElement]) -> set[str]:
    """Return the ids of a page."""
    if path in pages:
        return set(pages[path].xpath('//@id'))
    return set(re.findall(r' id="(.*?)"', path.read_text('utf-8')))


def lost(pages: dict[Path, html.HtmlElement]) -> Iterator[str]:
    """Yield the links of pages to files and anchors that are not there."""
    known: dict[Path, set[str]] = {}
    for path, page in pages.items():
        for target in set(page.xpath('//@href | //@src')):
            if re.match(r'(https?|mailto|data):', target):
                continue
            file, _, anchor = unquote(target).partition('#')
            found = Path(os.path.normpath(path.parent / file.partition('?')[0])) if file else path
            if not found.exists():
                yield f'{path.name}: {target}'
            elif anchor and found.suffix == '.html':
                if found not in known:
                    known[found] = anchors(found, pages)
                if anchor not in known[found]:
                    yield f'{path.name}: {target}'


@pytest.mark.long
def test_every_link_and_anchor_leads_somewhere(
    pages: dict[Path, html.HtmlElement], tmp_path: Path
) -> None:
    assert len(pages) > 60
    assert list(lost(pages)) == []
    # and the check finds what is lost
    (tmp_path / 'x.html').touch()
    page = html.fromstring('<p id="a"><a href="#a"/><a href="#b"/><img src="no.png"/></p>')
    assert sorted(lost({tmp_path / 'x.html': page})) == ['x.html: #b', 'x.html: no.png']


@pytest.mark.long
def test_nothing_is_loaded_from_the_network(pages: dict[Path, html.HtmlElement]) -> None:
    for path, page in pages.items():
        loaded = page.xpath('//@src | //link/@href')
        assert loaded
        assert not [target for target in loaded if re.match(r'(https?:)?//', target)], path


def public_names() -> Iterator[str]:
    """Yield the public classes, methods and functions of the whole package."""
    for path in (ROOT / 'denoc_ros').rglob('*.py'):
        module = '.'.join(path.relative_to(ROOT).with_suffix('').parts).removesuffix('.__init__')
        for node in ast.parse(path.read_text('utf-8')).body:
            if isinstance(node, ast.ClassDef | ast.FunctionDef) and node.name[0] != '_':
                yield f'{module}.{node.name}'
                for part in node.body if isinstance(node, ast.ClassDef) else ():
                    if isinstance(part, ast.FunctionDef) and part.name[0] != '_':
                        yield f'{module}.{node.name}.{part.name}'


@pytest.mark.long
def test_every_public_name_is_in_the_reference(site: Path) -> None:
    inventory = InventoryFile.loads((site / 'objects.inv').read_bytes(), uri='')
    known = {name for kind, names in inventory.data.items() if kind[:3] == 'py:' for name in names}
    assert len(denoc_ros.__all__) == 24
    assert {f'denoc_ros.{name}' for name in denoc_ros.__all__} <= known
    names = set(public_names())
    assert len(names) > 3000
    assert sorted(names - known) == []


@pytest.mark.long
def test_reference_shows_signatures_units_errors_and_sources(
    site: Path, pages: dict[Path, html.HtmlElement]
) -> None:
    page = pages[site / 'api' / 'index.html']
    (entry,) = page.xpath('//dt[@id="denoc_ros.Robot.inverse_dynamics"]')
    words = entry.getparent().text_content()
    for word in ('qdd', 'wrenches', '(n,)', 'StateError', 'N m'):
        assert word in words, word
    # its signature is a list, at which the parser ends the entry's head
    source = entry.xpath('following::a[span[@class="viewcode-link"]]/@href')[0]
    file, _, anchor = source.partition('#')
    text = (site / 'api' / file).read_text('utf-8')
    (line,) = re.findall(rf'<i id="{anchor}">.*?</i>(.*)', text)
    assert 'def inverse_dynamics' in line


@pytest.mark.long
def test_commands_are_those_of_the_command_line(
    site: Path, pages: dict[Path, html.HtmlElement]
) -> None:
    words = pages[site / 'api' / 'commands.html'].text_content()
    assert all(f'denoc {verb}' in words for verb in verbs())
    assert '--strip FILE' in words


@pytest.mark.long
@pytest.mark.parametrize('path', EXAMPLES, ids=[path.stem for path in EXAMPLES])
def test_an_example_is_short_and_has_a_law_and_a_picture(site: Path, path: Path) -> None:
    text = path.read_text('utf-8')
    assert len(text.splitlines()) <= LONGEST_EXAMPLE
    assert any(isinstance(node, ast.Assert) for node in ast.walk(ast.parse(text)))
    assert (site / '_images' / f'{path.stem}_1.png').stat().st_size > 5000
    assert f'{path.stem}.html' in (site / 'docs' / 'examples' / 'index.html').read_text('utf-8')


@pytest.mark.long
@pytest.mark.parametrize('path', NOTEBOOKS, ids=[path.stem for path in NOTEBOOKS])
def test_a_notebook_is_executed_and_offered(site: Path, path: Path) -> None:
    (offered,) = site.glob(f'_downloads/*/{path.stem}.ipynb')
    notebook = nbformat.read(offered, as_version=4)
    nbformat.validate(notebook)
    shown = {
        kind
        for cell in notebook.cells
        if cell.cell_type == 'code'
        for output in cell.outputs
        for kind in (output.data if output.output_type == 'display_data' else ('text',))
    }
    assert {'text', 'image/png'} <= shown


@pytest.mark.long
def test_the_viewer_is_in_a_notebook(site: Path, pages: dict[Path, html.HtmlElement]) -> None:
    (frame,) = pages[site / 'docs' / 'notebooks' / 'first_flexible_arm.html'].xpath(
        '//iframe/@src'
    )
    assert (site / 'docs' / 'notebooks' / frame).stat().st_size > 500_000


@pytest.mark.long
def test_formulas_are_mathml_and_words_can_be_searched(site: Path) -> None:
    assert '<math' in (site / 'docs' / 'dynamics.html').read_text('utf-8')
    index = (site / 'searchindex.js').read_text('utf-8')
    assert 'foreshorten' in index
    assert 'inverse_dynamics' in index


def test_settings_that_rosdoc2_runs_from_its_own_find_their_folder(tmp_path: Path) -> None:
    home = ROOT / 'docs' / 'site'
    lines = f'exec(open("{home}/conf.py").read())\nprint(HERE)\n'
    (tmp_path / 'conf.py').write_text(lines, encoding='utf-8')
    run = subprocess.run([sys.executable, 'conf.py'], cwd=tmp_path, capture_output=True, text=True)
    assert (run.stdout, run.stderr) == (f'{home}\n', '')
