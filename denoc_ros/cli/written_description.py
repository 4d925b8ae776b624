"""Where a changed description goes: into a new file, or into the robot's own."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

from denoc_ros.errors import ConfigError
from denoc_ros.output_files import write_new, write_text


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
        Both places are chosen, or the file cannot be written.
    BagError
        The new file exists already.
    """
    target = file if args.write else args.output
    if target is None:
        return ''
    if args.write and args.output is not None:
        raise ConfigError('--write', ['only one of --write and --output must be given, got both'])
    if args.write:
        write_text(file, text())
    else:
        write_new(target, text())
    return str(target)
