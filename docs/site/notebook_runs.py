"""Notebooks and examples, executed: their outputs, pictures and pages."""

from __future__ import annotations

import ast
import base64
import contextlib
import io
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import jupytext
import matplotlib as mpl
import nbformat
from nbformat.notebooknode import NotebookNode

FACE = {'figure.figsize': (7.0, 3.6), 'figure.dpi': 110, 'axes.grid': True, 'grid.alpha': 0.3}
FRAME = '<iframe src="../../{name}" title="{title}" loading="lazy" class="viewer"></iframe>'


@dataclass
class Ran:
    """An executed notebook or example.

    Attributes
    ----------
    name, title : str
        Of the page.
    is_example : bool
        A script of the gallery; else a notebook.
    figures : list of str
        File names of its pictures, beside the page.
    """

    name: str
    title: str
    is_example: bool
    figures: list[str] = field(default_factory=list)


def run_example(path: Path, folder: Path, extra: Path) -> Ran:
    """Run a script whose docstring is title and text; write its page and pictures."""
    text = path.read_text(encoding='utf-8')
    words = ast.get_docstring(ast.parse(text)) or ''
    title, _, rest = words.partition('\n')
    code = text.partition('"""\n')[2].strip()
    cells = [nbformat.v4.new_markdown_cell(f'# {title.rstrip(".")}\n{rest}')]
    notebook = nbformat.v4.new_notebook(cells=[*cells, nbformat.v4.new_code_cell(code)])
    ran = Ran(path.stem, title.rstrip('.'), is_example=True)
    return write_run(path, notebook, ran, folder, extra)


def run_notebook(path: Path, folder: Path, extra: Path) -> Ran:
    """Run a notebook written in Markdown; write its page, its pictures and its `.ipynb`."""
    notebook = jupytext.read(path)
    title = notebook.cells[0].source.partition('\n')[0].removeprefix('# ')
    ran = write_run(path, notebook, Ran(path.stem, title, is_example=False), folder, extra)
    nbformat.write(notebook, folder / f'{path.stem}.ipynb')
    return ran


def write_run(path: Path, notebook: NotebookNode, ran: Ran, folder: Path, extra: Path) -> Ran:
    """Execute the cells in turn, in one namespace; write the page."""
    mpl.use('agg')
    folder.mkdir(parents=True, exist_ok=True)
    extra.mkdir(parents=True, exist_ok=True)
    names: dict[str, Any] = {'__name__': '__main__'}
    parts = []
    for place, cell in enumerate(notebook.cells):
        if cell.cell_type == 'code':
            with mpl.rc_context(FACE):
                cell.outputs = outputs(cell.source, names, f'{path}, cell {place}')
            parts.append(f'```python\n{cell.source}\n```\n')
            parts += [shown(output, ran, folder, extra) for output in cell.outputs]
        else:
            parts.append(cell.source + '\n')
    kept = folder / path.name if ran.is_example else folder / f'{path.stem}.ipynb'
    kept.write_bytes(path.read_bytes() if ran.is_example else b'{}')
    parts.append(f'Download: [{kept.name}]({kept.name})\n')
    (folder / f'{path.stem}.md').write_text('\n'.join(parts), encoding='utf-8')
    return ran


def outputs(code: str, names: dict[str, Any], where: str) -> list[NotebookNode]:
    """Execute a cell; return what it printed, what its last line is worth, and its figures."""
    from matplotlib import pyplot

    tree = ast.parse(code)
    last = tree.body.pop() if isinstance(tree.body[-1], ast.Expr) else None
    value = None
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        exec(compile(tree, where, 'exec'), names)
        if isinstance(last, ast.Expr):
            value = eval(compile(ast.Expression(last.value), where, 'eval'), names)
    found = []
    if printed.getvalue():
        found.append(nbformat.v4.new_output('stream', text=printed.getvalue()))
    if hasattr(value, '_repr_html_'):
        found.append(display('text/html', value._repr_html_()))
    elif value is not None and not pyplot.get_fignums():
        found.append(display('text/plain', repr(value)))
    for number in pyplot.get_fignums():
        picture = io.BytesIO()
        pyplot.figure(number).savefig(picture, format='png', bbox_inches='tight')
        found.append(display('image/png', base64.b64encode(picture.getvalue()).decode()))
    pyplot.close('all')
    return found


def display(kind: str, content: str) -> NotebookNode:
    """Return an output of a type."""
    return nbformat.v4.new_output('display_data', data={kind: content})


def shown(output: NotebookNode, ran: Ran, folder: Path, extra: Path) -> str:
    """Return an output as Markdown; pictures and pages become files."""
    if output.output_type == 'stream':
        return f'```text\n{output.text.rstrip()}\n```\n'
    (kind, content), *_ = output.data.items()
    if kind == 'image/png':
        name = f'{ran.name}_{len(ran.figures) + 1}.png'
        (folder / name).write_bytes(base64.b64decode(content))
        ran.figures.append(name)
        return f'![{ran.title}]({name})\n'
    if kind == 'text/html':
        name = f'{ran.name}.html'
        (extra / name).write_text(content, encoding='utf-8')
        frame = FRAME.format(name=name, title=ran.title)
        return f'```{{raw}} html\n{frame}\n```\n'
    return f'```text\n{content}\n```\n'
