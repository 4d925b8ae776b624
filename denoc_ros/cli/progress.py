"""Progress on stderr: bars on a terminal, plain lines for a session elsewhere."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from tqdm import tqdm

from denoc_ros.terminal_text import say, visible, visible_cell


def share_bar(quiet: bool) -> Any:
    """Return a bar for shares of some work that add up to 1: a context with `update`."""
    return tqdm(
        total=1.0,
        disable=True if quiet else None,
        leave=False,
        bar_format='{l_bar}{bar}| [{elapsed}<{remaining}]',
    )


def seconds(duration: float) -> str:
    """Return a duration [s] in words: `8 s`, `2 min 5 s`."""
    minutes, rest = divmod(round(duration), 60)
    return f'{minutes} min {rest} s' if minutes else f'{rest} s'


class Progress:
    """Progress of a session; bars show only where stderr is a terminal."""

    def say(self, text: str) -> None:
        """Print a line."""
        tqdm.write(visible(text), file=sys.stderr)

    @contextmanager
    def step(self, what: str, expected: float = 0.0) -> Iterator[None]:
        """Print a step, its expected time [s; 0: untold], and its time once done."""
        began = time.perf_counter()
        told = f' (about {seconds(expected)})' if expected else ''
        say(f'{what}{told} ... ', end='', file=sys.stderr, flush=True)
        try:
            yield
        except BaseException:
            say(file=sys.stderr, flush=True)
            raise
        say(f'{time.perf_counter() - began:.1f} s', file=sys.stderr, flush=True)

    @contextmanager
    def phase(self, name: str, duration: float) -> Iterator[Callable[[float], None]]:
        """Show a bar over a phase of a duration [s]; yield its update by the time so far."""
        bar = tqdm(
            total=round(duration, 1),
            desc=visible_cell(name),
            unit='s',
            disable=not sys.stderr.isatty(),
            bar_format='{desc}: {percentage:3.0f}%|{bar}| {n:.1f}/{total:.1f} s',
        )

        def show(elapsed: float) -> None:
            bar.update(min(elapsed, bar.total) - bar.n)

        if bar.disable:
            self.say(f'{name}: {duration:g} s')
        with bar:
            yield show
