"""Topics by the end of their names, whatever namespace they are in."""

from __future__ import annotations

from collections.abc import Iterable


def find_topic(topics: Iterable[str], ending: str) -> str:
    """Return the topic of this name or, failing that, the first that ends so; '' for none."""
    names = sorted(topics)
    exact = [name for name in names if name.lstrip('/') == ending]
    return next(iter(exact + [name for name in names if name.endswith(f'/{ending}')]), '')
