"""Where a changed description goes: into a new file, or into the robot's own."""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable
from pathlib import Path


def write_description(args: argparse.Namespace, file: Path, text: Callable[[], str]) -> str:
    """Write a changed description to the chosen file; return its path, '' without one.

    Parameters
    ----------
    args : argparse.Namespace
        With `write` and `output`.
    file : Path
        The robot's file.
    text : callable
        Makes the description.

    Raises
    ------
    ConfigError
        Both places are chosen.
    OSError
        The new file exists already, or cannot be written.
    """
    from denoc_ros.errors import ConfigError

    target = file if args.write else args.output
    if target is None:
        return ''
    if args.write and args.output is not None:
        raise ConfigError('--write', ['only one of --write and --output must be given, got both'])
    if args.write:
        beside = file.with_name(file.name + '.new')
        beside.write_text(text(), encoding='utf-8')
        os.replace(beside, file)
    else:
        made = text()
        with target.open('x', encoding='utf-8') as stream:
            stream.write(made)
    return str(target)
