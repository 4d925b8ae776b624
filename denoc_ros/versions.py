"""The commit that a package is of. setup.py loads this file alone: it imports no other of ours."""

from __future__ import annotations

import subprocess
from pathlib import Path

GIT_TIMEOUT = 5.0  # s, of a question that takes milliseconds


def source_commit(package: Path) -> str:
    """Return the commit that a package's modules are of, '' where nobody knows.

    Parameters
    ----------
    package : path
        The folder of the modules. A built package has the commit in its file COMMIT; in a
        checkout git tells, with `-dirty` after the commit if tracked files were changed.
    """
    file = package / 'COMMIT'
    if file.is_file():
        return file.read_text(encoding='utf-8').strip()
    # a copy in somebody else's checkout is of none of its commits
    if not _git(package, 'ls-files', '--error-unmatch', '__init__.py'):
        return ''
    return _git(package, 'describe', '--always', '--dirty', '--exclude=*', '--abbrev=12')


def _git(folder: Path, *arguments: str) -> str:
    """Output of a git command, '' where it fails."""
    command = ['git', '--no-optional-locks', '-C', str(folder), *arguments]
    try:
        asked = subprocess.run(
            command,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=GIT_TIMEOUT,
            check=True,
        )
    except (OSError, subprocess.SubprocessError):
        return ''
    return asked.stdout.strip()
