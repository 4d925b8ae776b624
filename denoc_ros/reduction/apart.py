"""Work of others' compiled code in a process of its own, which bad input may end."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from denoc_ros.errors import ModelError


def arrays_of(script: str, given: Path, where: str, rule: str) -> dict[str, Any]:
    """Return the arrays that `python SCRIPT GIVEN MADE.npz` writes.

    Raises
    ------
    ModelError
        If it writes none, with the rule and the last line of what it said.
    """
    with tempfile.TemporaryDirectory(prefix='denoc-') as folder:
        made = Path(folder, 'made.npz')
        command = [sys.executable, script, str(given.resolve()), str(made)]
        ended = subprocess.run(
            command, cwd=folder, stdin=subprocess.DEVNULL, capture_output=True, check=False
        )
        if ended.returncode or not made.is_file():
            *_, last = [b'no word', *ended.stderr.strip().splitlines()]
            got = f'status {ended.returncode}: {last.decode(errors="replace")}'
            raise ModelError(where, [f'{rule}, got {got}'])
        with np.load(made, allow_pickle=False) as arrays:
            return dict(arrays)
