"""The command line of the benches that let blocks of loops take turns."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Sequence
from typing import Any, Protocol

from denoc_ros.errors import DenocError


class Found(Protocol):
    """What such a bench finds."""

    @property
    def met(self) -> bool: ...

    def record(self) -> dict[str, Any]: ...

    def text(self) -> list[str]: ...


def run(
    name: str,
    doc: str | None,
    measure: Callable[[float, int], Found],
    seconds: float,
    argv: Sequence[str] | None = None,
) -> int:
    """Run a bench; return the exit status: 0 met, 1 an error, 2 missed.

    Parameters
    ----------
    name, doc : str
        Of the bench's module.
    measure : callable
        Takes the length of a block [s], and how many of each kind there are.
    seconds : float
        Default of that length.
    argv : sequence of str, optional
        Default the process's own.
    """
    parser = argparse.ArgumentParser(description=(doc or '').splitlines()[0])
    parser.add_argument('--seconds', type=float, default=seconds, help='of a block, at most 15')
    parser.add_argument('--blocks', type=int, default=6, help='of each kind')
    parser.add_argument('--json', action='store_true', help='print machine-readable JSON')
    args = parser.parse_args(argv)
    return say(name, lambda: measure(args.seconds, args.blocks), args.json)


def say(name: str, measure: Callable[[], Found], as_json: bool) -> int:
    """Print what a bench finds; return the exit status."""
    try:
        found = measure()
    except DenocError as error:
        print(f'{name}: {error}', file=sys.stderr)
        return 1
    text = json.dumps(found.record(), indent=2, allow_nan=False)
    print(text if as_json else '\n'.join(found.text()))
    return 0 if found.met else 2
