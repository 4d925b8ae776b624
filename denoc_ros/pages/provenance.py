"""Provenance of a page: versions, machine, sources, without names of users, hosts or folders."""

from __future__ import annotations

import hashlib
import os
import platform
import shlex
from collections.abc import Mapping, Sequence
from datetime import datetime, timezone
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from denoc_ros.bags.digest import file_hash

PACKAGES = ('denoc_ros', 'numpy', 'numba', 'rclpy', 'rmw_fastrtps_cpp', 'mcap', 'rosbags')

MACHINE = ('system', 'processors')


def versions() -> dict[str, str]:
    """Return names and versions, in the order a reader looks for them."""
    found = {'python': platform.python_version()}
    for name in PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    found['system'] = f'{platform.system()} {platform.release()} {platform.machine()}'
    found['processors'] = str(os.cpu_count())
    return found


def provenance(
    command: str, sources: Mapping[str, str], made_with: Mapping[str, str] | None = None
) -> dict[str, str]:
    """Return the provenance at the foot of a page.

    Parameters
    ----------
    made_with : mapping, optional
        As `versions` returned it when the run was made; default: now.
    """
    used = dict(made_with or versions())
    machine = {name: used.pop(name) for name in MACHINE if name in used}
    rows = {
        'made': datetime.now(tz=timezone.utc).strftime('%Y-%m-%d %H:%M UTC'),
        'command': command,
        **sources,
        'versions': ', '.join(f'{name} {value}' for name, value in used.items()),
        'machine': ', '.join(
            f'{value} {name}'.removesuffix(' system') for name, value in machine.items()
        ),
    }
    return {name: value for name, value in rows.items() if value}


def named_file(path: str | Path) -> str:
    """Name of a file, or of a bag's folder, and the hash of its content."""
    return f'{Path(path).name}, SHA-256 {file_hash(path)}'


def named_text(name: str, text: str) -> str:
    """Return the name of a text and its hash, that of the file which holds just the text."""
    return f'{name}, SHA-256 {hashlib.sha256(text.encode()).hexdigest()}' if text else ''


def command_line(arguments: Sequence[str], program: str = 'denoc') -> str:
    """Return the command with files by their names only."""
    return shlex.join([*program.split(), *map(_public, arguments)])


def _public(argument: str) -> str:
    """Return an argument, a path without its folders; names of topics and fields stay."""
    option, equals, value = argument.partition('=') if argument[:1] == '-' else ('', '', argument)
    path = Path(value)
    is_path = any(
        folder.is_dir() for folder in path.parents if len(folder.parts) > path.is_absolute()
    )
    shown = path.name if os.sep in value and is_path else value
    return option + equals + shown
