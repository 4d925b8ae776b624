"""Tables for a terminal."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import zip_longest
from typing import Any

from denoc_ros.terminal_text import visible_cell

Row = dict[str, Any]


def text_table(rows: Sequence[Row]) -> str:
    """Return rows of equal keys as aligned columns; '' for no rows."""
    heads = [list(row) for row in rows[:1]]
    return aligned([*heads, *([cell_text(value) for value in row.values()] for row in rows)])


def aligned(cells: Sequence[Sequence[str]]) -> str:
    """Return lines of cells as aligned columns; a line may have fewer than others."""
    cells = [[visible_cell(cell) for cell in line] for line in cells]
    widths = [max(map(len, column)) for column in zip_longest(*cells, fillvalue='')]
    lines = [
        '  '.join(cell.ljust(width) for cell, width in zip(line, widths, strict=False)).rstrip()
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
