"""Tables for a terminal."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

Row = dict[str, Any]


def text_table(rows: Sequence[Row]) -> str:
    """Return rows of equal keys as aligned columns."""
    cells = [list(rows[0])] + [[cell_text(value) for value in row.values()] for row in rows]
    widths = [max(len(line[k]) for line in cells) for k in range(len(cells[0]))]
    lines = [
        '  '.join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip()
        for line in cells
    ]
    return '\n'.join(f'  {line}' for line in lines)


def cell_text(value: Any) -> str:
    """Return a value as a cell shows it: `-` for nothing, five digits of a number."""
    if value is None:
        return '-'
    if isinstance(value, float):
        return f'{value:.5g}'
    if isinstance(value, list):
        return ' '.join(cell_text(entry) for entry in value)
    return str(value) or '-'
