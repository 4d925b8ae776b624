"""Strip charts of a recorded run beside its pictures: one per quantity, a line for the time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from denoc_ros.units import si_prefix
from denoc_ros.viewer.recorded import RecordedRun

INK, MUTED, GRID = '#20242a', '#6b7280', '#e5e7eb'
CURVES = ('#d1622b', '#1f6fb2', '#2e8b57', '#8e5ea2', '#b8860b', '#4b5563')
MOST_CURVES = 6  # of a chart; the largest are shown
MOST_CHARTS = 3
SMALLEST = 1e-6  # prefix on an axis


def chart_groups(run: RecordedRun) -> dict[str, list[str]]:
    """Return the channels of each chart, by quantity and unit; not where all of them are 0."""
    groups: dict[str, list[str]] = {}
    for name in run.names:
        groups.setdefault(name.partition('/')[0], []).append(name)
    tell = [group for group, names in groups.items() if any(_peak(run, n) > 0.0 for n in names)]
    return {group: groups[group] for group in tell[:MOST_CHARTS]}


def draw_charts(figure: Figure, run: RecordedRun, groups: dict[str, list[str]]) -> list[Any]:
    """Draw the charts; return the lines that mark the time."""
    cursors = []
    width = 0.93 / max(len(groups), 1)
    for k, (group, names) in enumerate(groups.items()):
        axes = figure.add_axes((0.055 + k * width, 0.07, width - 0.06, 0.15))
        _chart(axes, run, group, names)
        cursors.append(axes.axvline(run.span[0], color=INK, lw=1.0))
    return cursors


def _chart(axes: Axes, run: RecordedRun, group: str, names: Sequence[str]) -> None:
    columns = {name: run.channel(name) for name in names}
    peaks = {name: _peak(run, name) for name in names}
    largest = sorted(names, key=lambda name: -peaks[name])[:MOST_CURVES]
    what, _, unit = group.rstrip(']').partition(' [')
    factor, prefix = si_prefix(max(peaks.values()), SMALLEST) if unit else (1.0, '')
    shown = [name for name in names if name in largest]
    whose = list(dict.fromkeys(_whose(name) for name in shown))
    for name in shown:
        label, colour = name.partition('/')[2], CURVES[whose.index(_whose(name)) % len(CURVES)]
        # predicted over true: dashes leave both to be seen
        style: Any = (0, (3, 2)) if label.startswith('predicted') else 'solid'
        values = columns[name] / factor
        axes.plot(run.t, values, color=colour, lw=1.2, ls=style, label=label)
    left_out = f', {len(shown)} of {len(names)}' if len(shown) < len(names) else ''
    title = f'{what}{left_out} [{prefix}{unit}]' if unit else f'{what}{left_out}'
    axes.set_title(title, loc='left', size=8.5, color=INK, pad=3)
    axes.legend(
        fontsize=6.5, frameon=False, loc='lower right', bbox_to_anchor=(1.02, 0.98), ncols=3,
        handlelength=1.4, columnspacing=0.8, labelcolor=MUTED, borderpad=0.0, labelspacing=0.2,
    )  # fmt: skip
    start, end = run.span
    axes.set_xlim(start, end if end > start else start + 1.0)
    axes.set_xlabel('time [s]', size=8, color=MUTED, labelpad=1)
    axes.grid(True, color=GRID, lw=0.6)
    axes.tick_params(colors=MUTED, labelsize=7.5, length=2)
    axes.yaxis.set_major_locator(MaxNLocator(4))
    for side in axes.spines.values():
        side.set_color(GRID)


def _peak(run: RecordedRun, name: str) -> float:
    return float(np.nanmax(np.abs(run.channel(name))))


def _whose(name: str) -> str:
    """Quantity of a channel, without its source."""
    return name.partition('/')[2].split(' ', 1)[-1]
