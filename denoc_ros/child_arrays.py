"""Arrays that other libraries read from foreign files, in a process of their own.

A file may end that process, or make it take all memory and time that it may have; this one goes
on. Plain arrays come back, never objects.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from denoc_ros import child_reader
from denoc_ros.errors import ModelError
from denoc_ros.python_start import file_words

MEMORY_BYTES = 2 << 30  # of the process that reads foreign files
WALL_S = 600.0  # of a process with bounds: far more than its processor time takes
LAST_CHARACTERS = 300  # of what the process said
# A pool of threads would take address space for each core of the machine.
_ENVIRONMENT = {'OPENBLAS_NUM_THREADS': '1', 'OMP_NUM_THREADS': '1'}

Arrays = dict[str, Any]


def child_arrays(
    script: str, files: Sequence[Path], memory: int = MEMORY_BYTES
) -> list[Arrays | str]:
    """Return what `read` of a script returns for each file, or a text: what was wrong with it.

    Parameters
    ----------
    script : str
        Path of a Python file with a function `read(file)` that returns arrays by name.
    files : sequence of path
        All are read by one process, and by another one behind a file that ends it.
    memory : int
        Bound on the memory of the process [bytes], and on its processor time; 0: no bounds.
    """
    found: list[Arrays | str] = []
    while len(found) < len(files):
        found += _read(script, files[len(found) :], memory)
    return found


def arrays_of(script: str, given: Path, where: str, rule: str, memory: int = 0) -> Arrays:
    """Return the arrays of one file; ModelError, with the rule, if there are none."""
    (found,) = child_arrays(script, [given], memory)
    if isinstance(found, str):
        raise ModelError(where, [f'{rule}, got: {found}'])
    return found


def _read(script: str, files: Sequence[Path], memory: int) -> list[Arrays | str]:
    """Return the results of one process: of all files, or up to the one that ended it."""
    with tempfile.TemporaryDirectory(prefix='denoc-') as folder:
        named = [str(file.resolve()) for file in files]
        words = file_words(child_reader.__file__, script, folder, str(memory), *named)
        ended = _ended([sys.executable, *words], folder, WALL_S if memory else None)
        found: list[Arrays | str] = []
        for k in range(len(files)):
            made, refused = Path(folder, f'{k}.npz'), Path(folder, f'{k}.txt')
            if refused.is_file():
                found.append(refused.read_text(encoding='utf-8'))
            elif made.is_file() and (k + 1 < len(files) or not ended):
                found.append(_loaded(made))
            else:
                return [*found, ended or 'no result']
        return found


def _ended(command: Sequence[str], folder: str, timeout: float | None) -> str:
    """Run a process; return how it failed, '' if it did not."""
    try:
        ended = subprocess.run(
            command,
            cwd=folder,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            check=False,
            timeout=timeout,
            env={**os.environ, **_ENVIRONMENT},
        )
    except subprocess.TimeoutExpired:
        return f'no end within {timeout:g} s'
    if not ended.returncode:
        return ''
    *_, last = [b'no word', *ended.stderr.strip().splitlines()]
    return f'status {ended.returncode}: {last.decode(errors="replace")[:LAST_CHARACTERS]}'


def _loaded(file: Path) -> Arrays | str:
    try:
        with np.load(file, allow_pickle=False) as held:
            names, *arrays = (held[name] for name in held.files)
            return dict(zip(names.tolist(), arrays, strict=True))
    except (ValueError, OSError, EOFError) as error:
        return f'no plain arrays: {error}'
