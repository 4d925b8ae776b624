"""Counts of how the code is built: lines, functions, arguments, repeated names, circles.

`python -m campaigns counts` prints them; `--json` prints for machines. It reads sources as text.
"""

from __future__ import annotations

import argparse
import ast
import json
import re
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import takewhile
from pathlib import Path
from statistics import median, quantiles
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = 'denoc_ros'
MOST_FILES = 20  # files in a folder, without its subfolders
Function = ast.FunctionDef | ast.AsyncFunctionDef


@dataclass(frozen=True)
class Module:
    """One source file."""

    name: str  # dotted
    room: str  # the subpackage that it stands in
    path: Path
    text: str
    tree: ast.Module


def modules(root: Path = ROOT) -> list[Module]:
    """Return the package's modules."""
    found = []
    for path in sorted((root / PACKAGE).rglob('*.py')):
        parts = path.relative_to(root).with_suffix('').parts
        name = '.'.join(parts[:-1] if parts[-1] == '__init__' else parts)
        room = parts[1] if len(parts) > 2 else '.'
        text = path.read_text(encoding='utf-8')
        found.append(Module(name, room, path, text, ast.parse(text)))
    return found


def functions(module: Module) -> Iterator[Function]:
    """Yield all functions and methods."""
    for node in ast.walk(module.tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            yield node


def length(function: Function) -> int:
    """Return the lines of a function without its docstring."""
    body = function.body
    first = body[0]
    is_docstring = isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant)
    skipped = (first.end_lineno or 0) - first.lineno + 1 if is_docstring else 0
    return (function.end_lineno or 0) - function.lineno + 1 - skipped


def argument_count(function: Function) -> int:
    """Return the number of arguments, `self` not counted."""
    given = function.args
    names = [a.arg for a in (*given.posonlyargs, *given.args, *given.kwonlyargs)]
    return len([name for name in names if name not in ('self', 'cls')])


def imports(module: Module, known: set[str]) -> set[str]:
    """Return the package's modules that a module imports, in functions and for types as well."""
    found = set()
    for node in ast.walk(module.tree):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            inside = [f'{node.module}.{alias.name}' for alias in node.names]
            names = [name if name in known else node.module for name in inside]
        else:
            continue
        found |= {name for name in names if name in known}
    return found - {module.name}


def in_circles(graph: dict[str, set[str]]) -> list[str]:
    """Return the modules that can be reached from themselves."""

    def reached(start: str) -> set[str]:
        seen: set[str] = set()
        waiting = list(graph[start])
        while waiting:
            name = waiting.pop()
            if name not in seen:
                seen.add(name)
                waiting += graph[name]
        return seen

    return sorted(name for name in graph if name in reached(name))


def _import_lines(module: Module) -> int:
    """Return the number of lines of all import statements."""
    return sum(
        (node.end_lineno or 0) - node.lineno + 1
        for node in ast.walk(module.tree)
        if isinstance(node, ast.Import | ast.ImportFrom)
    )


def late_imports(module: Module) -> int:
    """Return the number of import statements inside functions."""
    return len(
        {
            node
            for function in functions(module)
            for node in ast.walk(function)
            if isinstance(node, ast.Import | ast.ImportFrom)
        }
    )


def summaries(module: Module) -> Iterator[str]:
    """Yield the first lines of all docstrings."""
    for node in ast.walk(module.tree):
        if isinstance(node, ast.Module | ast.ClassDef | Function):
            yield (ast.get_docstring(node) or '').partition('\n')[0]


def short_with_one_user(found: Sequence[Module], graph: dict[str, set[str]]) -> list[str]:
    """Return the modules of at most 130 lines that exactly one other module imports."""
    users = Counter(name for used in graph.values() for name in used)
    return [m.name for m in found if users[m.name] == 1 and m.text.count('\n') <= 130]


def classes_behind(found: Sequence[Module], name: str) -> list[str]:
    """Return a class of the package and those that it inherits from, each once."""
    nodes = [node for m in found for node in ast.walk(m.tree) if isinstance(node, ast.ClassDef)]
    bases = {node.name: [b.id for b in node.bases if isinstance(b, ast.Name)] for node in nodes}
    behind = [name] if name in bases else []
    for each in behind:
        behind += [base for base in bases[each] if base in bases and base not in behind]
    return behind


def walks(root: Path = ROOT) -> dict[str, int]:
    """Return the number of files of each walk through the package that a reader is shown."""
    page = root / 'docs' / 'architecture.md'
    rows = page.read_text(encoding='utf-8').splitlines() if page.exists() else []
    start = (
        rows.index('| walk | files in order |') + 2 if '| walk | files in order |' in rows else 0
    )
    shown = list(takewhile(bool, rows[start:])) if start else []
    return {row.split('|')[1].strip(): len(re.findall(r'`\w+/[\w/]+\.py`', row)) for row in shown}


def optional_parts(root: Path = ROOT) -> tuple[str, ...]:
    """Return the names of the optional parts, which `denoc_ros/parts.py` lists."""
    file = root / PACKAGE / 'parts.py'
    text = file.read_text(encoding='utf-8') if file.is_file() else 'PARTS = ()'
    for node in ast.parse(text).body:
        if isinstance(node, ast.Assign) and getattr(node.targets[0], 'id', '') == 'PARTS':
            return tuple(ast.literal_eval(node.value))
    return ()


def counts(root: Path = ROOT) -> dict[str, Any]:
    """Return all counts."""
    found = modules(root)
    known = {module.name for module in found}
    lengths = [length(f) for module in found for f in functions(module)]
    classes = Counter(
        node.name for m in found for node in ast.walk(m.tree) if isinstance(node, ast.ClassDef)
    )
    lines: Counter[str] = Counter()
    for module in found:
        lines[module.room] += module.text.count('\n')
    kernels = [f for m in found if m.room == 'kernels' for f in functions(m)]
    others = [f for m in found if m.room != 'kernels' for f in functions(m)]
    graph = {m.name: imports(m, known) for m in found}
    optional = optional_parts(root)
    core = sum(count for room, count in lines.items() if room not in optional)
    files = Counter(m.path.parent.relative_to(root) for m in found)
    names = Counter(m.path.name for m in found if m.path.name != '__init__.py')
    asking = [m for m in found if m.room not in ('model', 'dynamics')]
    return {
        'lines': dict(sorted(lines.items())),
        'lines of the core': core,
        'lines of optional parts': sum(lines.values()) - core,
        'lines in all': sum(lines.values()),
        'files': dict(sorted(Counter(module.room for module in found).items())),
        'files in all': len(found),
        'folders with more than 20 files': sorted(
            str(folder) for folder, count in files.items() if count > MOST_FILES
        ),
        'file names that occur twice': sorted(n for n, times in names.items() if times > 1),
        'import lines': sum(_import_lines(module) for module in found),
        'imports inside functions': sum(late_imports(module) for module in found),
        'imports inside functions of cli': sum(late_imports(m) for m in found if m.room == 'cli'),
        'lines with TYPE_CHECKING': sum(module.text.count('TYPE_CHECKING') for module in found),
        'modules of at most 130 lines with one user': len(short_with_one_user(found, graph)),
        'summaries with "what"': sum(
            bool(re.search(r'\bwhat\b', text, re.IGNORECASE))
            for module in found
            for text in summaries(module)
        ),
        'function lines: median': median(lengths),
        'function lines: 90th percentile': quantiles(lengths, n=10)[-1],
        'function lines: longest': max(lengths),
        'arguments: most in a kernel': max(map(argument_count, kernels)),
        'kernels with more than 10 arguments': sum(argument_count(f) > 10 for f in kernels),
        'arguments: most elsewhere': max(map(argument_count, others)),
        'functions with more than 8 arguments': sum(argument_count(f) > 8 for f in others),
        'class names that occur twice': sorted(n for n, times in classes.items() if times > 1),
        'modules in an import circle': in_circles(graph),
        'classes behind Robot': classes_behind(found, 'Robot'),
        'files of the walks': walks(root),
        'definitions of Array': sum(
            bool(re.search(r'^Array = ', module.text, re.MULTILINE)) for module in found
        ),
        'uses of arrays. outside model, dynamics': sum(
            len(
                re.findall(
                    r'\barrays\.(?:topology|constants|diagonals|frame_rows|constraint_names|axes|bodies)\b',
                    module.text,
                )
            )
            for module in asking
        ),
    }


def shown(value: Any) -> str:
    """Return a count as text."""
    if isinstance(value, dict):
        return ', '.join(f'{name} {count}' for name, count in value.items())
    if isinstance(value, list):
        return f'{len(value)}' + (f': {", ".join(value)}' if value else '')
    return f'{value:g}'


def main(argv: Sequence[str] | None = None) -> int:
    """Print the counts."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').splitlines()[0])
    parser.add_argument('--json', action='store_true', help='print for machines')
    parser.add_argument('root', nargs='?', type=Path, default=ROOT, help='of a checkout')
    args = parser.parse_args(argv)
    found = counts(args.root)
    if args.json:
        print(json.dumps(found, indent=2))
    else:
        for name, value in found.items():
            print(f'{name}: {shown(value)}')
    return 0


if __name__ == '__main__':
    sys.exit(main())
