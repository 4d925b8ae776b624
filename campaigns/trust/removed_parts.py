"""Each optional part removed from a copy of the checkout: what is left passes `make check`.

`python -m campaigns parts` tries all parts, `python -m campaigns parts planning --quick` one of
them without the tests. The copies have the files that git knows.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from denoc_ros.parts import PARTS, parts

ROOT = Path(__file__).resolve().parents[2]
# what imports all of the package that is left, and asks each verb and each node what it has
INSIDE = """
import importlib, importlib.util, pkgutil, sys
import denoc_ros
for part in sys.argv[1:]:
    assert importlib.util.find_spec('denoc_ros.' + part) is None, part + ' must not be found'
from denoc_ros.cli.main import build_parser
from denoc_ros.cli.verbs import verbs
from denoc_ros.parts import nodes, parameter_table
for module in pkgutil.walk_packages(denoc_ros.__path__, 'denoc_ros.'):
    importlib.import_module(module.name)
for name in denoc_ros.__all__:
    getattr(denoc_ros, name)
for verb in verbs():
    build_parser([verb])
for node in nodes():
    parameter_table(node)
print(' '.join(verbs()))
"""
# An editable installation has a finder that finds a removed part in its own checkout.
SITE = """
import sys
known = [(each, getattr(each, '__module__', '')) for each in sys.meta_path]
sys.meta_path[:] = [each for each, module in known if not module.startswith('__editable__')]
"""


def gone(part: str) -> set[str]:
    """Return a part and those that need it."""
    return {part, *(name for name, each in parts().items() if part in each.needs)}


def remove(part: str, target: Path) -> Path:
    """Return a copy of the checkout without a part, and without those that need it."""
    listed = subprocess.run(
        ['git', 'ls-files', '--cached', '--others', '--exclude-standard', '-z'],
        cwd=ROOT, capture_output=True, check=True, text=True,
    )  # fmt: skip
    left_out = tuple(f'{room}/{name}/' for name in gone(part) for room in ('denoc_ros', 'test'))
    for name in filter(None, listed.stdout.split('\0')):
        if not name.startswith(left_out) and (ROOT / name).is_file():
            (target / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, target / name)
    return target


def commands(part: str, quick: bool) -> list[list[str]]:
    """Return what must succeed without a part: all of `make check`, or without its tests."""
    bin_folder = Path(sys.executable).parent
    found = [
        [sys.executable, '-c', INSIDE, *sorted(gone(part))],
        [str(bin_folder / 'lint-imports')],
    ]
    if not quick:
        tests = [str(bin_folder / 'pytest'), '-q', '-m', 'not ros and not long']
        found += [
            [str(bin_folder / 'ruff'), 'check', '.'],
            [str(bin_folder / 'mypy')],
            [*tests, '--numprocesses', 'auto', '--dist', 'loadfile'],
        ]
    return found


def attempt(part: str, quick: bool) -> str:
    """Remove a part from a copy and try what is left; return what failed, '' if nothing did."""
    with tempfile.TemporaryDirectory(prefix='denoc-parts-') as folder:
        copy = remove(part, Path(folder) / 'checkout')
        (copy.parent / 'sitecustomize.py').write_text(SITE, encoding='utf-8')
        for command in commands(part, quick):
            done = subprocess.run(
                command, cwd=copy, capture_output=True, text=True, env=environment(copy)
            )
            if done.returncode:
                return f'{Path(command[0]).name}: {(done.stdout + done.stderr)[-4000:]}'
    return ''


def environment(copy: Path) -> dict[str, str]:
    """Return this process's environment, with the copy's package and no other."""
    return {**os.environ, 'PYTHONPATH': f'{copy}{os.pathsep}{copy.parent}'}


def main(arguments: Sequence[str] | None = None) -> int:
    """Try the parts that are named, by default all."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').splitlines()[0])
    parser.add_argument('parts', nargs='*', metavar='PART', help='default: all')
    parser.add_argument('--quick', action='store_true', help='without tests, style and types')
    args = parser.parse_args(arguments)
    unknown = sorted(set(args.parts) - set(PARTS))
    if unknown:
        parser.error(f'PART must be one of {", ".join(PARTS)}; got {", ".join(unknown)}')
    failures = 0
    for part in args.parts or PARTS:
        failed = attempt(part, args.quick)
        failures += bool(failed)
        print(f'without {part}: {failed or "passes"}', flush=True)
    return int(failures > 0)


if __name__ == '__main__':
    sys.exit(main())
