"""The section of a parameter file that contains a name.

Files have a section for each node, or for many: `/**` is for every node. rclpy hands a node the
sum of all that match.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from itertools import pairwise
from pathlib import Path
from typing import Any

from denoc_ros.errors import ConfigError
from denoc_ros.yaml_text import read_yaml_file

VALUES = 'ros__parameters'
WILD = ('*', '**')
FLAGS = ('--params-file', '-p', '--param')


def shared_names(arguments: Sequence[str], node: str) -> set[str]:
    """Return the parameters that are given to all nodes alike, and not to this one by its name.

    Parameters
    ----------
    arguments : sequence of str
        A command line, with its `--ros-args`.
    node : str
        Fully qualified name of the node.

    Returns
    -------
    set of str
        Dotted names that stand in sections such as `/**` only.
    """
    shared: set[str] = set()
    own: set[str] = set()
    for flag, value in _ros_arguments(arguments):
        if flag != '--params-file':
            own.add(value.partition(':=')[0].rpartition(':')[2])
            continue
        for pattern, names in _sections(value):
            if _matches(pattern, node):
                (shared if pattern[-1] in WILD else own).update(names)
    return shared - own


def _ros_arguments(arguments: Sequence[str]) -> Iterator[tuple[str, str]]:
    """Yield the arguments that concern parameters: flag and value."""
    inside = False
    for word, after in pairwise([*arguments, '']):
        inside = word == '--ros-args' or (inside and word != '--')
        if inside and word in FLAGS:
            yield word, after


def _sections(file: str) -> Iterator[tuple[list[str], list[str]]]:
    """Yield each section of a file, its name by parts, with the parameters it has.

    A file that cannot be read has none: rclpy has said what is wrong with it.
    """
    with suppress(ConfigError):
        yield from _below([], read_yaml_file(Path(file)))


def _below(path: list[str], found: Any) -> Iterator[tuple[list[str], list[str]]]:
    if not isinstance(found, Mapping):
        return
    for key, value in found.items():
        if key == VALUES:
            yield path, list(_names(value))
        else:
            yield from _below([*path, *str(key).strip('/').split('/')], value)


def _names(values: Any, prefix: str = '') -> Iterator[str]:
    if not isinstance(values, Mapping):
        return
    for key, value in values.items():
        if isinstance(value, Mapping):
            yield from _names(value, f'{prefix}{key}.')
        else:
            yield f'{prefix}{key}'


def _matches(pattern: Sequence[str], node: str) -> bool:
    """Say whether a section is for a node, as rcl does."""
    words = {'**': r'(/\w+)*', '*': r'/\w+'}
    return bool(re.fullmatch(''.join(words.get(w, '/' + re.escape(w)) for w in pattern), node))
