"""Pages of the site: those of the repository, the reference from the code, runs and notebooks.

They are written into the folder that Sphinx reads, which is not in the repository.
"""

from __future__ import annotations

import argparse
import ast
import html
import inspect
import os
import re
import shutil
import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from docutils import nodes
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.application import Sphinx
from sphinx.config import Config
from sphinx.domains.python import ObjectEntry, PythonDomain
from sphinx.environment import BuildEnvironment
from sphinx.ext.autodoc.mock import ismock, mock
from sphinx.pycode import ModuleAnalyzer

import denoc_ros
from denoc_ros.cli.main import build_parser, verbs

if TYPE_CHECKING:
    from notebook_runs import Ran

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / 'denoc_ros'
PROJECT = ('CHANGELOG', 'CONTRIBUTING', 'SECURITY', 'CODE_OF_CONDUCT')
# files that pages link to: they are offered as they are
FILES = ('LICENSE', 'CITATION.cff', 'config', '.github')
ROOMS = {
    'dynamics': 'Robot: the verbs of the dynamics',
    'kernels': 'the compiled recursion, on plain arrays',
    'model': 'the robot model: URDF and flexibility',
    'bags': 'recordings',
    'estimation': 'observer, fusion, joint motion',
    'simulation': 'scenarios and runs; recorded runs computed again',
    'runtime': 'clocks, limits, references and live models of the nodes',
    'nodes': 'the ROS 2 nodes',
    'cli': 'the code of the commands',
    'pages': 'layout of pages, figures',
    'planning': 'motions without residual vibration',
    'feedback': 'state feedback and strain feedback about a plan',
    'identification': 'decays, joints, servos, whole models, tracking, calibration',
    'reduction': 'links from meshes and finite elements',
    'reports': 'pages of runs, and their numbers',
    'viewer': 'the page in the browser, films',
    'export': 'models for other simulators',
}


def write_pages(app: Sphinx, config: Config) -> None:
    """Fill the folder that Sphinx reads."""
    folder = Path(app.srcdir)
    config.version = config.release = package_version()
    extra = folder / 'extra'
    config.html_extra_path = [str(extra)]
    copy_pages(folder)
    mocked = config.autodoc_mock_imports
    rooms = {room: words for room, words in ROOMS.items() if f'denoc_ros.{room}' not in mocked}
    # without kernels, as on docs.ros.org, nothing is run
    runs = run_all(folder, extra) if 'kernels' in rooms else []
    write_gallery(folder, [run for run in runs if run.is_example])
    write_notebooks(folder)
    with mock(mocked):
        if 'kernels' in rooms:
            uncompile()
        write_reference(folder / 'api', rooms)
    write_index(folder, rooms, with_runs=bool(runs))
    write_sources(extra / 'source')


def package_version() -> str:
    """Return the version, which stands in package.xml only."""
    return ElementTree.parse(ROOT / 'package.xml').getroot().findtext('version') or ''


def copy_pages(folder: Path) -> None:
    """Copy the pages as they are, with all that they show and link to."""
    for name in ('notebooks', 'examples'):
        shutil.copytree(ROOT / 'docs' / name, folder / 'docs' / name, dirs_exist_ok=True)
    for path in (ROOT / 'docs').iterdir():
        if path.suffix == '.md':
            text = path.read_text(encoding='utf-8').replace('](../README.md', '](../index.md')
            (folder / 'docs' / path.name).write_text(text, encoding='utf-8')
        elif path.is_file():
            shutil.copy(path, folder / 'docs')
    for name in PROJECT:
        text = (ROOT / f'{name}.md').read_text(encoding='utf-8')
        text = text.replace('](README.md', '](index.md')
        # a folder of the repository: the first of its files
        text = text.replace('](.github/ISSUE_TEMPLATE)', '](.github/ISSUE_TEMPLATE/fault.yml)')
        (folder / f'{name}.md').write_text(text, encoding='utf-8')
    for name in FILES:
        if (ROOT / name).is_dir():
            shutil.copytree(ROOT / name, folder / name, dirs_exist_ok=True)
        else:
            shutil.copy(ROOT / name, folder)


def contents() -> dict[str, list[str]]:
    """Return the pages of the table in docs/index.md, by its headings."""
    found: dict[str, list[str]] = {}
    for line in (ROOT / 'docs' / 'index.md').read_text(encoding='utf-8').splitlines():
        if heading := re.fullmatch(r'\| \*\*(.+)\*\* \| \|', line):
            pages = found.setdefault(heading[1], [])
        elif found and line.startswith('| ['):
            pages += [f'docs/{name}' for name in re.findall(r'\]\((\w+)\.md\)', line)]
    return found


def write_index(folder: Path, rooms: Mapping[str, str], with_runs: bool) -> None:
    """Write the first page: the README, and all pages in the sidebar."""
    found = contents()
    first, *others = found
    ran = ['docs/notebooks/index'] + ['docs/examples/index'] * with_runs
    rows = {first: ['docs/index', *found[first], *ran]}
    rows |= {name: found[name] for name in others}
    rows['reference'] = ['api/index', 'api/commands', *(f'api/{room}' for room in rooms)]
    rows['project'] = list(PROJECT)
    trees = [
        '\n'.join(['```{toctree}', ':hidden:', f':caption: {name}', '', *pages, '```', ''])
        for name, pages in rows.items()
    ]
    text = (ROOT / 'README.md').read_text(encoding='utf-8')
    (folder / 'index.md').write_text('\n'.join([text, *trees]), encoding='utf-8')


def run_all(folder: Path, extra: Path) -> list[Ran]:
    """Run all examples and notebooks in the repository's folder; write their pictures."""
    # docs.ros.org, which runs none, has no jupytext
    from notebook_runs import run_example, run_notebook

    here = Path.cwd()
    os.chdir(ROOT)
    try:
        examples = [
            run_example(path, folder / 'docs' / 'examples', extra)
            for path in sorted((ROOT / 'docs' / 'examples').glob('*.py'))
        ]
        return examples + [
            run_notebook(path, folder / 'docs' / 'notebooks', extra)
            for path in sorted((ROOT / 'docs' / 'notebooks').glob('*.md'))
        ]
    finally:
        os.chdir(here)


def write_gallery(folder: Path, runs: list[Ran]) -> None:
    """Write the page with a picture of each example, if they were run."""
    if not runs:
        return
    cards = [
        f'```{{figure}} {run.figures[0]}\n:target: {run.name}.html\n:alt: {run.title}\n\n'
        f'{run.title}\n```\n'
        for run in runs
    ]
    tree = ['```{toctree}', ':hidden:', '', *(run.name for run in runs), '```', '']
    words = 'Each picture is made by a script of at most 40 lines, when this site is built.\n'
    lines = ['# Gallery\n', words, '````{container} gallery', *cards, '````\n', *tree]
    (folder / 'docs' / 'examples' / 'index.md').write_text('\n'.join(lines), encoding='utf-8')


def write_notebooks(folder: Path) -> None:
    """Write the page that lists the notebooks."""
    names = [path.stem for path in (ROOT / 'docs' / 'notebooks').glob('*.md')]
    names.sort(key=['first_flexible_arm', 'plan', 'decay'].index)
    words = 'Each is executed when this site is built, and can be downloaded as a notebook.\n'
    lines = ['# Notebooks\n', words, '```{toctree}', '', *names, '```\n']
    (folder / 'docs' / 'notebooks' / 'index.md').write_text('\n'.join(lines), encoding='utf-8')


def room_modules(room: str) -> list[str]:
    """Return the names of a room's modules, the room's own first."""
    paths = sorted((PACKAGE / room).rglob('*.py'))
    names = ['.'.join(path.relative_to(ROOT).with_suffix('').parts) for path in paths]
    return sorted(name.removesuffix('.__init__') for name in names)


def root_modules() -> list[str]:
    """Return the names of the modules that are in no room."""
    return [f'denoc_ros.{path.stem}' for path in sorted(PACKAGE.glob('[a-z]*.py'))]


def uncompile() -> None:
    """Put the Python of each compiled function in its place: a reference has functions.

    From here on no kernel runs in this process.
    """
    from denoc_ros.kernels.jit.compiled import APART, kernel_modules

    for module in kernel_modules():
        for key, value in list(vars(module).items()):
            symbol = getattr(value, 'symbol', None)  # of a function that others call by it
            compiled = APART[symbol] if isinstance(symbol, str) else value
            if inspect.isfunction(python := getattr(compiled, '__wrapped__', None)):
                setattr(module, key, python)


def titled(title: str, line: str = '=') -> list[str]:
    """Return a title as reStructuredText."""
    return [title, line * len(title), '']


def write_reference(folder: Path, rooms: Mapping[str, str]) -> None:
    """Write the pages of the public names, of each room and of the commands."""
    folder.mkdir(exist_ok=True)
    names = denoc_ros.__all__
    lines = titled('Python') + [
        'The public names of ``import denoc_ros as dn``. The pages of the packages have every '
        'public class and function. Topics, services and parameters of the nodes are in '
        ':doc:`../docs/nodes`, options of the commands in :doc:`commands`.',
        '',
        '.. autosummary::',
        '   :nosignatures:',
        '',
        *(f'   ~denoc_ros.{name}' for name in names),
        '',
    ]
    for name in names:
        kind = 'class' if isinstance(getattr(denoc_ros, name), type) else 'function'
        kind = 'exception' if name.endswith('Error') else kind
        lines += titled(name, '-') + [f'.. auto{kind}:: denoc_ros.{name}']
        lines += ['   :members:', '   :inherited-members: Exception', ''] * (kind == 'class') + [
            ''
        ]
    (folder / 'index.rst').write_text('\n'.join(lines), encoding='utf-8')
    for room, words in rooms.items():
        modules = room_modules(room) + (root_modules() if room == 'dynamics' else [])
        # its names are found; all its words would take a quarter of the build
        lines = [':nosearch:', '', *titled(f'{room}: {words}')]
        for name in modules:
            lines += titled(name, '-') if name != modules[0] else []
            lines += [f'.. automodule:: {name}', '   :members:', '   :ignore-module-all:', '']
        (folder / f'{room}.rst').write_text('\n'.join(lines), encoding='utf-8')
    (folder / 'commands.rst').write_text('\n'.join(commands()), encoding='utf-8')


def commands() -> list[str]:
    """Return the reference of the command line, from its parsers."""
    lines = titled('Commands')
    for verb in verbs():
        (action,) = sub_parsers(build_parser([verb]))
        lines += titled(f'denoc {verb}', '-') + usage(action.choices[verb])
    return lines


def sub_parsers(parser: argparse.ArgumentParser) -> list[Any]:
    """Return the action of a parser that has others under it."""
    return [a for a in parser._actions if isinstance(a, argparse._SubParsersAction)]


def usage(parser: argparse.ArgumentParser) -> list[str]:
    """Return a command's description and options, and those of the commands under it."""
    lines = [escaped(parser.description or ''), '', '.. code-block:: text', '']
    lines += [f'   {line}' for line in parser.format_usage().splitlines()] + ['']
    for action in parser._actions:
        if isinstance(action, argparse._HelpAction | argparse._SubParsersAction):
            continue
        told = action.metavar or (None if action.nargs == 0 else action.dest.upper())
        shown = ' '.join(told) if isinstance(told, tuple) else told or ''
        if action.choices is not None and not action.metavar:
            shown = '{' + ','.join(map(str, action.choices)) + '}'
        options = ', '.join(action.option_strings)
        words = (action.help or '').replace('%(default)s', str(action.default)).replace('%%', '%')
        lines += [f'``{" ".join(filter(None, (options, shown)))}``', f'   {escaped(words)}', '']
    for action in sub_parsers(parser):
        for name, child in action.choices.items():
            lines += titled(f'{parser.prog.removeprefix("denoc ")} {name}', '~') + usage(child)
    return lines


CODE = re.compile(r'(``.+?``|`[^`\n]+`)')


def escaped(text: str) -> str:
    """Return plain words as reStructuredText; what stands in backquotes is left."""
    parts = CODE.split(text)
    parts[::2] = [re.sub(r'([*|])', r'\\\1', part) for part in parts[::2]]
    parts[::2] = [re.sub(r'(?<=\w)_(?!\w)', r'\\_', part) for part in parts[::2]]
    # an address in an explanation is none to go to
    parts[::2] = [part.replace('://', r'\://') for part in parts[::2]]
    return ''.join(parts)


def plain_words(
    _app: Sphinx, _kind: str, _name: str, _object: object, _options: object, lines: list[str]
) -> None:
    """Escape the marks of reStructuredText that docstrings use as signs of mathematics."""
    literal: int | None = None  # indentation of the paragraph that announced a literal block
    for place, line in enumerate(lines):
        indent = len(line) - len(line.lstrip())
        if literal is not None and line.strip() and indent <= literal:
            literal = None
        if literal is None:
            # a unit alone on its line is no item of a list
            lines[place] = re.sub(r'^(\s*)(\w\.)$', r'\1\\\2', escaped(line))
            if line.rstrip().endswith('::'):
                literal = indent


def plain_aliases(
    _app: Sphinx,
    _kind: str,
    _name: str,
    _of: Any,
    _options: Any,
    given: str | None,
    back: str | None,
) -> tuple[str | None, ...]:
    """Return a signature with the names of aliases, also where these stand in other types."""
    return tuple(
        text and re.sub(r"TypeAliasForwardRef\('(\w+)'\)", r'\1', text) for text in (given, back)
    )


@cache
def definitions(module: str) -> dict[str, int]:
    """Return the line of each class and function of a module, by its qualified name."""
    path = ROOT.joinpath(*module.split('.'))
    file = path / '__init__.py' if path.is_dir() else path.with_suffix('.py')
    found: dict[str, int] = {}

    def visit(body: list[ast.stmt], prefix: str) -> None:
        for node in body:
            if isinstance(node, ast.ClassDef | ast.FunctionDef):
                found[prefix + node.name] = node.lineno
                if isinstance(node, ast.ClassDef):
                    visit(node.body, f'{prefix}{node.name}.')

    visit(ast.parse(file.read_text(encoding='utf-8')).body, '')
    return found


def source_link(module: str, name: str) -> str | None:
    """Return where the source of a name is, from the folder of the reference."""
    if not module:  # of a signature that stands in a docstring
        return None
    found: Any = import_module(module)
    for part in name.split('.'):
        found = getattr(found, part, None)
    found = getattr(found, 'fget', None) or getattr(found, '__func__', found)
    home = str(getattr(found, '__module__', None) or module)
    qualified = str(getattr(found, '__qualname__', name))
    if not home.startswith('denoc_ros') or ismock(found):  # inherited, a value or a stand-in
        home, qualified = module, name
    line = definitions(home).get(qualified)
    return line and f'../source/{home}.html#L{line}'


SOURCE = """<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{name}</title>
<meta name="viewport" content="width=device-width"><meta name="color-scheme" content="light dark">
<link rel="stylesheet" href="../_static/site.css"></head><body class="source">
<p><a href="../api/index.html">reference</a> · <code>{name}</code></p><pre>{lines}</pre></body>
</html>
"""


def write_sources(folder: Path) -> None:
    """Write each module's source as a page with an anchor at each line."""
    folder.mkdir(parents=True, exist_ok=True)
    for path in PACKAGE.rglob('*.py'):
        name = '.'.join(path.relative_to(ROOT).with_suffix('').parts).removesuffix('.__init__')
        rows = html.escape(path.read_text(encoding='utf-8')).splitlines()
        lines = '\n'.join(f'<i id="L{k}">{k:4}</i>  {row}' for k, row in enumerate(rows, 1))
        (folder / f'{name}.html').write_text(SOURCE.format(name=name, lines=lines), 'utf-8')


def draw_layers(app: Sphinx, tree: nodes.document) -> None:
    """Draw Mermaid's flow charts as boxes one above the other: its own program is not needed."""
    for block in list(tree.findall(nodes.literal_block)):
        if block.get('language') == 'mermaid':
            block.replace_self(nodes.raw('', layers(block.astext()), format='html'))


def layers(chart: str) -> str:
    """Return a flow chart of a single chain, whose steps may be groups, as HTML."""
    labels, groups, group = {}, {}, ''
    for line in chart.splitlines():
        if started := re.match(r'\s*subgraph (\w+)', line):
            group = started[1]
            groups[group] = []
        elif line.strip() == 'end':
            group = ''
        elif box := re.match(r'\s*(\w+)\["(.*)"\]', line):
            labels[box[1]] = box[2]
            groups.setdefault(group or box[1], []).append(box[1])
    (chain,) = re.findall(r'^\s*(\w+(?: --> \w+)+)$', chart, re.MULTILINE)
    rows = [
        ''.join(f'<span>{html.escape(labels[name])}</span>' for name in groups[step])
        for step in chain.split(' --> ')
    ]
    return '<div class="layers">' + ''.join(f'<div>{row}</div>' for row in rows) + '</div>'


def show_mathml(translator: Any, node: nodes.math) -> None:
    """Write a formula as MathML, which browsers draw without a program."""
    translator.body.append(tex2mathml(node.astext()))
    raise nodes.SkipNode


def show_mathml_block(translator: Any, node: nodes.math_block) -> None:
    """Write a displayed formula as MathML."""
    translator.body.append(f'<div class="math">{tex2mathml(node.astext(), as_block=True)}</div>')
    raise nodes.SkipNode


def analyze(analyzer: ModuleAnalyzer) -> None:
    """Find the order of a module's names: tokenizing all of it too would take half of the time.

    Autodoc asks for comments on attributes, overloads and annotations as well; docstrings have
    these here.
    """
    analyzer.annotations, analyzer.attr_docs, analyzer.overloads = {}, {}, {}
    analyzer.finals, analyzer.tags = [], {}
    names = definitions(analyzer.modname) if analyzer.modname.startswith('denoc_ros') else {}
    analyzer.tagorder = {name: place for place, name in enumerate(names)}
    analyzer._analyzed = True


class RememberedNames(PythonDomain):
    """Names of the reference, each sought once: a type stands in thousands of signatures.

    Those that end as no object does, such as `float`, are not sought among all objects.
    """

    count = 0  # of the objects of which this is remembered
    ends: frozenset[str] = frozenset()
    known: dict[tuple[object, ...], list[tuple[str, ObjectEntry]]]

    def find_obj(
        self,
        env: BuildEnvironment,
        modname: str,
        classname: str,
        name: str,
        type: str | None,
        searchmode: int = 0,
    ) -> list[tuple[str, ObjectEntry]]:
        """Return the objects of a name, as seen from a module and a class."""
        if self.count != len(self.objects):
            self.count, self.known = len(self.objects), {}
            self.ends = frozenset(map(last_name, self.objects))
        if last_name(name) not in self.ends:
            return []
        key = modname, classname, name, type, searchmode
        if key not in self.known:
            self.known[key] = super().find_obj(env, modname, classname, name, type, searchmode)
        return self.known[key]


def last_name(name: str) -> str:
    """Return the last part of a dotted name, as roles may give it."""
    return name.removesuffix('()').rpartition('.')[2]


def setup(app: Sphinx) -> dict[str, bool]:
    """Register with Sphinx."""
    ModuleAnalyzer.analyze = analyze
    app.add_domain(RememberedNames, override=True)
    app.add_html_math_renderer('mathml', (show_mathml, None), (show_mathml_block, None))
    app.connect('config-inited', write_pages)
    app.connect('autodoc-process-docstring', plain_words, priority=400)
    app.connect('autodoc-process-signature', plain_aliases)
    app.connect('doctree-read', draw_layers)
    return {'parallel_read_safe': True, 'parallel_write_safe': True}
